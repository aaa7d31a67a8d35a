"""The hub's poses and counts become the streams ``pose`` and ``width``, at their own rate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_converters.exumi_session.gripper import MODULUS, widths_of
from exumi_converters.exumi_session.hub import usable
from exumi_converters.exumi_session.plan import EpisodePlan, Latency
from exumi_converters.exumi_session.tables import Readings
from exumi_data.geometry import make_sign_continuous
from exumi_data.model import (
    CalibrationItem,
    Clock,
    Frames,
    Gap,
    QualityNote,
    RawData,
    Sensor,
)
from exumi_data.standard import flags
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import strictly_increasing
from exumi_data.width_map import NOT_CALIBRATED, WIDTH_MAP

__all__ = ["StampedTimes", "add_readings", "stamped_times", "stream_clock"]

Int64Array = NDArray[np.int64]

_GAP_PERIODS = 2.5
_FLAGS = {name: np.uint32(flag.mask) for name, flag in flags().items()}


@dataclass(frozen=True, slots=True, eq=False)
class StampedTimes:
    """The times of a stream's samples.

    Attributes
    ----------
    time : (N,) int64
        Strictly increasing, counted from the episode's start.
    time_host : (N,) int64
        As the hub stamped them, Unix time.
    flags : (N,) uint32
    gaps : list of Gap
    """

    time: Int64Array
    time_host: Int64Array
    flags: NDArray[np.uint32]
    gaps: list[Gap]


def stream_clock(plan: EpisodePlan, late: Latency) -> Clock:
    """Return the clock of a stream that the hub stamped.

    Parameters
    ----------
    plan : EpisodePlan
    late : Latency
    """
    return Clock(
        source="hub_unix",
        stamp_point="user_rx",
        t_ref_ns=plan.start_ns,
        latency_ns=late.latency_ns,
        latency_sigma_ns=None if late.sigma_ns is None else float(late.sigma_ns),
        raw_time="time_host",
        method=late.method,
    )


def stamped_times(
    time_host: Int64Array, plan: EpisodePlan, late: Latency, lost: Sequence[tuple[int, str]] = ()
) -> StampedTimes:
    """Return times and gaps: a gap is where nothing came for more than 2.5 periods.

    Parameters
    ----------
    time_host : (N,) int64
        In the order of arrival.
    plan : EpisodePlan
    late : Latency
    lost : sequence of (int, str)
        After which sample files are missing, and why.
    """
    time, nudged = strictly_increasing(time_host - plan.start_ns - late.latency_ns)
    marks = np.where(nudged, _FLAGS["time_nudged"], np.uint32(0)).astype(np.uint32)
    reasons = dict(lost)
    steps = np.diff(time_host)
    forward = steps[steps > 0]
    period = float(np.median(forward)) if len(forward) else np.inf
    gaps = []
    for after in np.flatnonzero(steps > _GAP_PERIODS * period).tolist():
        gaps.append(Gap(after=after, reason=reasons.get(after, "no sample came")))
        marks[after + 1] |= _FLAGS["gap_before"]
    return StampedTimes(time, time_host, marks, gaps)


def add_readings(
    writer: EpisodeWriter,
    plan: EpisodePlan,
    readings: Readings,
    lost: Sequence[tuple[int, str]] = (),
) -> None:
    """Write the streams ``pose`` and ``width``.

    Parameters
    ----------
    writer : EpisodeWriter
    plan : EpisodePlan
    readings : Readings
        Of the episode's time, in the order of arrival.
    lost : sequence of (int, str)
        After which of them files are missing, and why.
    """
    _add_poses(writer, plan, readings, lost)
    _add_widths(writer, plan, readings, lost)


def _add_poses(
    writer: EpisodeWriter,
    plan: EpisodePlan,
    readings: Readings,
    lost: Sequence[tuple[int, str]],
) -> None:
    times = stamped_times(readings.time_ns, plan, plan.pose, lost)
    good = usable(readings.poses)
    poses = np.full(readings.poses.shape, np.nan)
    if good.any():
        kept = readings.poses[good].copy()
        kept[:, 3:] /= np.linalg.norm(kept[:, 3:], axis=1, keepdims=True)
        kept[:, 3:] = make_sign_continuous(kept[:, 3:])
        poses[good] = kept
    marks = times.flags | np.where(good, np.uint32(0), _FLAGS["invalid"])
    stream = writer.add_stream(
        "pose",
        kind="pose",
        clock=stream_clock(plan, plan.pose),
        gaps=times.gaps or None,
        frames=Frames(parent="world", child="controller"),
        description="the controller as the headset's app sends it, in the world that was marked "
        "(right-handed, Z up), as the hub computed it",
    )
    stream.append(times.time, poses, time_host=times.time_host, flags=marks)


def _add_widths(
    writer: EpisodeWriter,
    plan: EpisodePlan,
    readings: Readings,
    lost: Sequence[tuple[int, str]],
) -> None:
    late = Latency(latency_ns=0, sigma_ns=None, method="stamped right after the encoder was read")
    times = stamped_times(readings.time_ns, plan, late, lost)
    item = None if plan.gripper is None else CalibrationItem.model_validate(plan.gripper)
    widths, invalid, outside = widths_of(item, readings.counts)
    marks = times.flags | np.where(invalid, _FLAGS["invalid"], np.uint32(0))
    marks |= np.where(outside, _FLAGS["out_of_range"], np.uint32(0))
    raw = RawData(unit="count", modulus=MODULUS)
    if item is None:
        message = (
            "nothing says which count stands for which opening: the counts are kept in `raw`, no "
            "width is known"
        )
        writer.metadata.quality.append(
            QualityNote(code=NOT_CALIBRATED, message=message, stream="width")
        )
    else:
        raw.transform = WIDTH_MAP
        writer.metadata.calibration[WIDTH_MAP] = item
    if outside.any():
        message = (
            f"{np.count_nonzero(outside)} of {len(outside)} counts lie beyond the gripper's "
            "calibration: its end is held"
        )
        writer.metadata.quality.append(
            QualityNote(code="out-of-range", message=message, stream="width")
        )
    stream = writer.add_stream(
        "width",
        kind="width",
        clock=stream_clock(plan, late),
        gaps=times.gaps or None,
        raw=raw,
        sensor=Sensor(model="as5600"),
    )
    fits = (readings.counts >= 0) & (readings.counts <= np.iinfo(np.uint16).max)
    counts = np.where(fits, readings.counts, np.iinfo(np.uint16).max).astype(np.uint16)
    stream.append(times.time, widths, raw=counts, time_host=times.time_host, flags=marks)
