"""What the simulated sensors deliver: samples at their own rate, on their own clock, late.

Every sensor samples the same truth at its own instants (`capture_time_ns`), regular but for a
small jitter, and its samples are stamped on arrival, a constant `latency_ns` later (`time_ns`).
So ``time_ns - latency_ns`` is exactly when the sample was taken, and ``render(i)`` and ``data[i]``
show the truth of that moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["SimulatedStream", "StreamKind", "sample_times_ns"]

StreamKind = Literal["tactile", "rgb", "pose", "width"]


@dataclass(frozen=True, slots=True)
class SimulatedStream:
    """One sensor's samples.

    Attributes
    ----------
    name : str
        Such as ``tactile_left``.
    kind : {"tactile", "rgb", "pose", "width"}
        What it measures.
    rate_hz : float
        Nominal sampling rate.
    latency_ns : int
        Time from capture to stamp, the same for every sample.
    time_ns : ndarray of int64, shape (N,)
        Stamps as a recorder would see them, nanoseconds since session start, latency included,
        strictly increasing.
    sequence : ndarray of int64, shape (N,)
        The sensor's own sample numbers; a lost sample leaves a gap.
    data : ndarray or None
        Pose: (N, 7) float64, ``T_world_gripper`` as x y z qx qy qz qw in metres, with the
        tracker's noise. Width: (N,) float32, metres, made from `raw`. None for images.
    raw : ndarray of uint16, shape (N,), or None
        Width only: the encoder's wrapped counts.
    reference : ndarray of uint8, shape (H, W, 3), or None
        Tactile only: the image without contact, free of noise.
    renderer : callable or None
        Images only: gives image `i`; use `render`.
    """

    name: str
    kind: StreamKind
    rate_hz: float
    latency_ns: int
    time_ns: NDArray[np.int64]
    sequence: NDArray[np.int64]
    data: NDArray[np.float64] | NDArray[np.float32] | None = None
    raw: NDArray[np.uint16] | None = None
    reference: NDArray[np.uint8] | None = None
    renderer: Callable[[int], NDArray[np.uint8]] | None = None

    @property
    def capture_time_ns(self) -> NDArray[np.int64]:
        """When the samples were taken: ``time_ns - latency_ns``, (N,) int64."""
        return self.time_ns - self.latency_ns

    @property
    def is_image(self) -> bool:
        """Whether the samples are images, to be had by `render`."""
        return self.renderer is not None

    def __len__(self) -> int:
        return len(self.time_ns)

    def render(self, index: int) -> NDArray[np.uint8]:
        """Return image `index`, drawn now; the same index gives the same image, in any thread.

        Parameters
        ----------
        index : int
            Which image, from 0 to ``len(self) - 1``; negative numbers count from the end.

        Returns
        -------
        ndarray of uint8, shape (H, W, 3)
            RGB image.

        Raises
        ------
        IndexError
            If there is no such image.
        TypeError
            If the stream has no images.
        """
        if self.renderer is None:
            raise TypeError(f"Stream {self.name!r} of kind {self.kind} has no images; use `data`.")
        if not -len(self) <= index < len(self):
            raise IndexError(f"Stream {self.name!r} has {len(self)} images, not number {index}.")
        return self.renderer(index % len(self))


def sample_times_ns(
    rng: np.random.Generator,
    duration_s: float,
    rate_hz: float,
    *,
    jitter_s: float,
    drop: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return when a sensor takes its samples.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of phase, jitter and losses.
    duration_s : float
        Length of the session, seconds.
    rate_hz : float
        Nominal rate.
    jitter_s : float
        Standard deviation of a sample's time about its regular place, seconds; cut at a third of
        the period, so that the order is kept.
    drop : float
        Part of the samples that are lost, 0 to below 1; the first and the last never are.

    Returns
    -------
    time_ns, sequence : ndarray of int64, shape (N,)
        Capture times (nanoseconds since session start, strictly increasing, within the session)
        and the sensor's sample numbers.
    """
    period_s = 1.0 / rate_hz
    number = np.arange(int(duration_s * rate_hz))
    jitter = np.clip(rng.normal(0.0, jitter_s, len(number)), -period_s / 3, period_s / 3)
    time_s = (number + rng.uniform(0.35, 0.65)) * period_s + jitter
    kept = rng.random(len(number)) >= drop
    kept[[0, -1]] = True
    time_ns = np.round(time_s * 1e9).astype(np.int64)
    return time_ns[kept], number[kept].astype(np.int64)
