"""A simulated microphone: a process that serves blocks of sound over a UNIX socket.

    python -m exumi_recorders.simulated.sound '{"socket": "...", "epoch_ns": ...}'

What it hears is known: a click at every whole second of the session, over faint noise. Its own
clock may drift. Sample i is taken at ``start(0) + i / (rate · (1 + drift))``; block k begins with
sample k · block, and its stamp is when that sample reached the hub: `latency_ns` and a jitter
later.
"""

import contextlib
import sys
import threading
from fractions import Fraction

import numpy as np
from pydantic import Field

from exumi_data.time import NS_PER_S
from exumi_recorders.simulated.schedule import FramedSetup
from exumi_recorders.simulated.serving import serve_frames

__all__ = ["SoundSetup", "block_of", "serve"]

_CLICK_HZ, _CLICK_S, _CLICK = 2000.0, 0.002, 20_000.0
_NOISE = 20.0


class SoundSetup(FramedSetup):
    """A simulated microphone, served as `FramedSetup` says.

    Attributes
    ----------
    rate, channels, block : int
        Samples per second by its own clock, channels, samples of a block.
    drift_ppm : float
        How much faster than that it really is.
    latency_ns : int
        From a sample to the hub.
    """

    rate: int = Field(default=48_000, ge=1000, le=768_000)
    channels: int = Field(default=1, ge=1, le=64)
    block: int = Field(default=960, ge=1, le=1 << 20)
    drift_ppm: float = Field(default=0.0, gt=-1e5, lt=1e5)
    latency_ns: int = Field(default=2_000_000, ge=0)

    @property
    def true_rate(self) -> Fraction:
        """Samples per second of CLOCK_MONOTONIC."""
        return self.rate * (1 + Fraction(self.drift_ppm) / 1_000_000)

    @property
    def period(self) -> Fraction:
        """Nanoseconds of a block."""
        return self.block * NS_PER_S / self.true_rate

    @property
    def stamp_delay_ns(self) -> int:
        """From a block's first sample to its stamp."""
        return self.latency_ns

    @property
    def hand_out_delay_ns(self) -> int:
        """A block is handed out when its last sample is there."""
        return round(self.period)


def block_of(setup: SoundSetup, k: int) -> bytes:
    """Return the sound of block `k`: (block, channels) int16, little-endian."""
    first_s = (setup.start_ns(k) - setup.epoch_ns) / NS_PER_S
    t_s = first_s + np.arange(setup.block) / float(setup.true_rate)
    since_click_s = t_s % 1.0
    click = np.exp(-since_click_s / _CLICK_S) * np.sin(2 * np.pi * _CLICK_HZ * since_click_s)
    noise = np.random.default_rng((setup.seed, 4, k)).normal(0, _NOISE, (setup.block, 1))
    sound = _CLICK * click[:, None] + noise
    return np.repeat(sound.astype("<i2"), setup.channels, axis=1).tobytes()


def serve(setup: SoundSetup, stop: threading.Event | None = None) -> None:
    """Be a microphone until `stop`.

    Parameters
    ----------
    setup : SoundSetup
    stop : threading.Event, optional
    """
    serve_frames(setup, lambda k: block_of(setup, k), stop)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        serve(SoundSetup.model_validate_json(sys.argv[1]))
