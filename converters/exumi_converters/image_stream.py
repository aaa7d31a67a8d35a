"""What image streams of all sources have in common: name, sensor, clock, gaps and notes."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

import numpy as np

from exumi_data.model import Clock, Gap, Sensor
from exumi_data.store.stream_writer import StreamWriter

__all__ = ["AddedStream", "StreamSpec", "describe_clock", "find_gaps", "is_nominal", "times_of"]


@dataclass(frozen=True, slots=True)
class AddedStream:
    """An image stream that was written.

    Attributes
    ----------
    stream : StreamWriter
    times : (n,) int64
        The time of every frame of the source, ns; also of those that were left out because they
        cannot be decoded.
    """

    stream: StreamWriter
    times: np.ndarray


_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSpec:
    """Which stream the images become.

    Attributes
    ----------
    name : str
    kind : {"tactile", "rgb"}
    sensor : str or None
        Sensor model.
    """

    name: str = "tactile"
    kind: Literal["tactile", "rgb"] = "tactile"
    sensor: str | None = None

    def fields(self) -> dict[str, Any]:
        """Return what `EpisodeWriter.add_stream` takes."""
        return {} if self.sensor is None else {"sensor": Sensor(model=self.sensor)}


def times_of(pts: Sequence[int], time_base: Fraction) -> np.ndarray:
    """Turn presentation times into nanoseconds.

    Parameters
    ----------
    pts : sequence of int
    time_base : Fraction
        Seconds per unit.

    Returns
    -------
    (n,) int64
    """
    scale = time_base * _NS_PER_S
    return np.array([round(value * scale) for value in pts], dtype=np.int64)


def is_nominal(time: np.ndarray, rate: Fraction, tolerance_s: float) -> bool:
    """Whether all times are whole periods apart, within a tolerance.

    Parameters
    ----------
    time : (n,) int64
    rate : Fraction
    tolerance_s : float
        What the container rounds to.
    """
    periods = (time - time[:1]).astype(np.float64) * (float(rate) / _NS_PER_S)
    whole = np.round(periods)
    off = np.abs(periods - whole) / float(rate)
    return bool((off <= max(tolerance_s, 1e-6)).all() and (np.diff(whole) >= 1).all())


def describe_clock(
    stream: StreamWriter,
    time: np.ndarray,
    rate: Fraction | None,
    time_base: Fraction,
    *,
    source: str = "container",
) -> None:
    """Say in a stream's metadata how the times of its file came about, and what is missing.

    A container that numbers its frames at a constant rate measured nothing: its times are the
    nominal rate's. Frames that are missing in between do not change that; they are gaps.

    Parameters
    ----------
    stream : StreamWriter
    time : (n,) int64
    rate : Fraction or None
        The container's.
    time_base : Fraction
        Seconds per unit of its times.
    source : str
        Name of the clock.
    """
    nominal = rate is not None and is_nominal(time, rate, float(time_base) / 2)
    stamp_point: Literal["nominal_rate", "container_pts"] = (
        "nominal_rate" if nominal else "container_pts"
    )
    stream.model.clock = Clock(source=source, stamp_point=stamp_point)
    if rate is not None:
        stream.model.nominal_rate = f"{rate.numerator}/{rate.denominator}"
    if rate is not None and nominal:
        gaps = find_gaps(time, rate)
        if gaps:
            stream.model.gaps = gaps


def find_gaps(time: np.ndarray, rate: Fraction) -> list[Gap]:
    """Find where samples of a constant rate are missing.

    Parameters
    ----------
    time : (n,) int64
    rate : Fraction
    """
    periods = np.diff(time).astype(np.float64) * (float(rate) / _NS_PER_S)
    steps = np.round(periods).astype(np.int64)
    reason = "the source has no such frame, or it cannot be decoded"
    return [
        Gap(after=int(i), lost=int(steps[i]) - 1, reason=reason) for i in np.flatnonzero(steps > 1)
    ]
