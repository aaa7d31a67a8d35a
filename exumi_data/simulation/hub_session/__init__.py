"""A raw exUMI session as its hub and its GoPro write it, with known truth.

>>> from exumi_data.simulation.hub_session import simulate_hub_session
>>> session = simulate_hub_session(folder, demonstrations=2)  # doctest: +SKIP
"""

from exumi_data.simulation.hub_session.session import (
    HubSession,
    HubSettings,
    simulate_hub_session,
)
from exumi_data.simulation.hub_session.truth import HubTruth

__all__ = ["HubSession", "HubSettings", "HubTruth", "simulate_hub_session"]
