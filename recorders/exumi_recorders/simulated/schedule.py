"""When a simulated device sends its frames, and what becomes of each: pure functions of k.

Frame k begins at ``epoch + phase + k · period``; its stamp lies `stamp_delay_ns` and a jitter
later, cut to microseconds; it is handed out `hand_out_delay_ns` after the stamp.
"""

from abc import abstractmethod
from fractions import Fraction
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from exumi_data.time import NS_PER_S

__all__ = ["Fate", "FramedSetup"]

Fate = Literal["sent", "dropped", "damaged", "cut"]
"""What becomes of a frame: lost in the kernel, flagged as damaged, or cut off without a flag."""

_US = 1000
_MOST_JITTER = 3.0


class FramedSetup(BaseModel):
    """What all devices have that serve frames over a socket.

    Attributes
    ----------
    socket : str
        Path of the UNIX socket that it serves.
    epoch_ns : int
        CLOCK_MONOTONIC at the session's start.
    seed : int
        Of everything that is left to chance.
    jitter_ns : int
        Standard deviation of the stamps, cut at three times.
    drop, damage, cut : float
        Parts of the frames that the kernel loses, calls damaged, or that end too early.
    slow_start_s : float
        From the connection to the first frame.
    absent_s : tuple of (float, float)
        When it is unplugged: from, to, seconds since the epoch.
    buffers : int
        How many frames may wait for a slow reader before the next ones are lost.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    socket: str
    epoch_ns: int
    seed: int = Field(default=0, ge=0)
    jitter_ns: int = Field(default=300_000, ge=0)
    drop: float = Field(default=0.0, ge=0.0, lt=1.0)
    damage: float = Field(default=0.0, ge=0.0, lt=1.0)
    cut: float = Field(default=0.0, ge=0.0, lt=1.0)
    slow_start_s: float = Field(default=0.0, ge=0.0)
    absent_s: tuple[tuple[float, float], ...] = ()
    buffers: int = Field(default=4, ge=1)

    @property
    @abstractmethod
    def period(self) -> Fraction:
        """Nanoseconds from one frame to the next."""

    @property
    @abstractmethod
    def stamp_delay_ns(self) -> int:
        """From the start of a frame to its stamp, without jitter."""

    @property
    @abstractmethod
    def hand_out_delay_ns(self) -> int:
        """From the stamp until the frame is handed out."""

    def start_ns(self, k: int) -> int:
        """Return when frame `k` begins, CLOCK_MONOTONIC."""
        phase = Fraction(int(np.random.default_rng((self.seed, 0)).integers(1000)), 1000)
        return self.epoch_ns + round((k + phase) * self.period)

    def stamp_ns(self, k: int) -> int:
        """Return the stamp of frame `k`."""
        jitter = 0
        if self.jitter_ns:
            normal = np.random.default_rng((self.seed, 1, k)).standard_normal()
            jitter = round(self.jitter_ns * float(np.clip(normal, -_MOST_JITTER, _MOST_JITTER)))
        return (self.start_ns(k) + self.stamp_delay_ns + jitter) // _US * _US

    def due_ns(self, k: int) -> int:
        """Return when frame `k` is handed out."""
        return self.stamp_ns(k) + self.hand_out_delay_ns

    def first_frame(self, now_ns: int) -> int:
        """Return the first frame that begins at or after `now_ns`."""
        k = int((now_ns - self.epoch_ns) // self.period)
        while self.start_ns(k) < now_ns:
            k += 1
        return max(k, 0)

    def fate(self, k: int) -> Fate:
        """Return what becomes of frame `k`."""
        if not (self.drop or self.damage or self.cut):
            return "sent"
        chance = float(np.random.default_rng((self.seed, 2, k)).random())
        fates: tuple[tuple[Fate, float], ...] = (
            ("dropped", self.drop),
            ("damaged", self.damage),
            ("cut", self.cut),
        )
        for fate, part in fates:
            if chance < part:
                return fate
            chance -= part
        return "sent"

    def absence_end_s(self, now_ns: int) -> float | None:
        """Return when the device is there again (seconds since the epoch), None if it is there."""
        now_s = (now_ns - self.epoch_ns) / NS_PER_S
        return next((end for start, end in self.absent_s if start <= now_s < end), None)
