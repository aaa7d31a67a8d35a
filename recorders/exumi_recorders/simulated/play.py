"""The session that a simulated device takes part in, as options and as truth."""

from functools import lru_cache
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    from exumi_data.simulation import PlaySession

__all__ = ["SimulatedPlay"]


class SimulatedPlay(BaseModel):
    """Which session, and when it began on the hub's clock.

    All devices of a rig share one: then the truth at a sample is that of its host time less the
    epoch.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    seed: int = Field(default=0, ge=0)
    duration_s: float = Field(default=20.0, ge=3.0, allow_inf_nan=False)
    taps: int = Field(default=0, ge=0)
    epoch_ns: int
    """CLOCK_MONOTONIC at the session's start."""

    def session(self) -> "PlaySession":
        """Return the session; the same one for the same numbers."""
        return _session(self.seed, self.duration_s, self.taps)


@lru_cache(maxsize=4)
def _session(seed: int, duration_s: float, taps: int) -> "PlaySession":
    from exumi_data.simulation import simulate_play

    return simulate_play(seed=seed, duration_s=duration_s, taps=taps)
