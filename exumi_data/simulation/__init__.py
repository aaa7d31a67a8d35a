"""A simulated play session with known truth.

A hand-held gripper with a gel pad in each fingertip picks up, turns, lets slide and puts down
objects from a table. What really happens is known at every instant (`Truth`); the sensors sample
it at their own rates, with jitter, latency and, on request, losses (`SimulatedStream`).

>>> from exumi_data.simulation import simulate_play
>>> session = simulate_play(seed=1, duration_s=10.0)
>>> tactile = session.streams["tactile_left"]
>>> tactile.render(0).shape
(240, 320, 3)
"""

from __future__ import annotations

from exumi_data.simulation.encoder import WidthEncoder
from exumi_data.simulation.objects import OBJECTS, Finger, SimulatedObject
from exumi_data.simulation.session import DEFAULT_LATENCY_NS, PlaySession, simulate_play
from exumi_data.simulation.streams import SimulatedStream, StreamKind
from exumi_data.simulation.truth import Grasp, Truth

__all__ = [
    "DEFAULT_LATENCY_NS",
    "OBJECTS",
    "Finger",
    "Grasp",
    "PlaySession",
    "SimulatedObject",
    "SimulatedStream",
    "StreamKind",
    "Truth",
    "WidthEncoder",
    "simulate_play",
]
