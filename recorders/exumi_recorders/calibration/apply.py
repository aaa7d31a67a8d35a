"""Putting a calibration into episodes: times and widths are computed again from what was recorded.

Raw values and raw times stay as they are, byte for byte. An episode is written anew beside itself
and takes its own place when it is complete: one revision later. Where nothing changes, nothing is
written.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from exumi_data.calibration_items import LATENCY
from exumi_data.clips.frames import fitting
from exumi_data.episode import Episode, StreamView, open_episode
from exumi_data.errors import UsageError
from exumi_data.model.calibration import INTRINSICS, RECTIFICATION, RIG_REFERENCE, Intrinsics
from exumi_data.model.clock import Clock
from exumi_data.model.description import CalibrationItem, QualityNote
from exumi_data.model.documents import dump
from exumi_data.model.images import VideoImages
from exumi_data.model.streams import RawData, TactileStream, WidthStream, images_of
from exumi_data.standard import flags, units
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import apply_clock, strictly_increasing
from exumi_data.width_map import NOT_CALIBRATED, WIDTH_MAP, WidthMap, read_width_map
from exumi_recorders.calibration.files import Calibration
from exumi_recorders.calibration.tactile import DEPTH_TABLE, SCALE
from exumi_recorders.placed_clips import placed_by

__all__ = ["NOTE", "Applied", "apply_calibration", "named"]

NOTE = "calibration-applied"
"""Code of the quality note that says which calibration an episode was corrected by."""

# Poses and pictures are late by parts of a second; even what the internet carries is by no more.
_MOST_LATENCY_NS = 10_000_000_000
_OF_STREAMS = (LATENCY, INTRINSICS, RECTIFICATION, RIG_REFERENCE, DEPTH_TABLE, SCALE)
_IMAGES = (INTRINSICS, RECTIFICATION, RIG_REFERENCE)


@dataclass(frozen=True)
class Applied:
    """What became of an episode.

    Attributes
    ----------
    path : str
    revision : int
        Of the episode now.
    changed : tuple of str
        Items that are new or others than before.
    times, widths : tuple of str
        Streams whose times, or widths, were computed again.
    out_of_range : dict of str to int
        For the streams of `widths`, how many readings are beyond the map.
    left_out : dict of str to str
        Items that were not applied, and why.
    is_changed : bool
        Whether the episode was written anew, or would be.
    """

    path: str
    revision: int
    changed: tuple[str, ...]
    times: tuple[str, ...]
    widths: tuple[str, ...]
    out_of_range: dict[str, int]
    left_out: dict[str, str]
    is_changed: bool


@dataclass
class _Plan:
    """What is to change in an episode."""

    items: dict[str, CalibrationItem] = field(default_factory=dict)
    arrays: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    fields: dict[str, dict[str, Any]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    out_of_range: dict[str, int] = field(default_factory=dict)

    def change(self, stream: str, arrays: dict[str, np.ndarray], **fields: Any) -> None:
        self.arrays.setdefault(stream, {}).update(arrays)
        self.fields.setdefault(stream, {}).update(fields)


def apply_calibration(
    path: Path,
    calibration: Calibration,
    source: str,
    *,
    dry_run: bool = False,
    durable: bool = True,
) -> Applied:
    """Bring an episode's calibration, times and widths to what a calibration says.

    Parameters
    ----------
    path : pathlib.Path
        The episode's folder.
    calibration : Calibration
    source : str
        Where it is from, for the episode's note: see `named`.
    dry_run : bool, optional
        Only tell what would change.
    durable : bool, optional
        Make it survive a power loss before the old one is replaced.

    Returns
    -------
    Applied

    Raises
    ------
    UsageError
        The episode is packed.
    ExumiError
        The episode cannot be read, or is not complete.
    """
    with open_episode(path) as episode:
        if not path.is_dir():
            raise UsageError(
                "is packed, and packed episodes are not changed",
                where=path,
                fix="Apply the calibration to the folder, and pack that again.",
            )
        plan = _planned(episode, calibration)
        changed = bool(plan.items or plan.fields)
        now = episode.metadata.revision + (1 if changed else 0)
        if changed and not dry_run:
            episode.check_complete()
            _write(path, episode, calibration, plan, source, durable=durable)
    return Applied(
        path=str(path),
        revision=now,
        changed=tuple(plan.items),
        times=tuple(name for name, arrays in plan.arrays.items() if "time" in arrays),
        widths=tuple(name for name, arrays in plan.arrays.items() if "data" in arrays),
        out_of_range=plan.out_of_range,
        left_out=plan.left_out,
        is_changed=changed,
    )


def _planned(episode: Episode, calibration: Calibration) -> _Plan:
    plan = _Plan()
    wanted = dict(calibration.items)
    for name, item in calibration.items.items():
        reason, fitted = _fitted(episode, name, item, calibration.arrays.get(name))
        if reason is not None:
            plan.left_out[name] = reason
            del wanted[name]
        else:
            wanted[name] = fitted
    for name, item in list(wanted.items()):
        if name.startswith(LATENCY):
            reason = _retimed(episode[name.removeprefix(LATENCY)], item, plan)
            if reason is not None:
                plan.left_out[name] = reason
                del wanted[name]
        elif name.startswith(SCALE):
            stream = episode[name.removeprefix(SCALE)]
            if getattr(stream.metadata, "mm_per_px", None) != item.value:
                plan.change(stream.name, {}, mm_per_px=item.value)
    for stream in episode.streams.values():
        _move_along(episode, stream, plan)
    _remap(episode, wanted, plan)
    for name, item in wanted.items():
        if not _same(episode, name, item, calibration.arrays.get(name)):
            plan.items[name] = item
    return plan


def _fitted(
    episode: Episode, name: str, item: CalibrationItem, array: np.ndarray | None
) -> tuple[str | None, CalibrationItem]:
    """Return why an item does not fit an episode, or None and the item as it fits."""
    prefix = next((prefix for prefix in _OF_STREAMS if name.startswith(prefix)), None)
    if prefix is None:
        return None, item
    stream = name.removeprefix(prefix)
    if stream not in episode:
        return "the episode has no such stream", item
    if prefix == SCALE and not isinstance(episode[stream].metadata, TactileStream):
        return "the stream is not tactile", item
    if prefix in _IMAGES:
        return _fitted_to_images(episode[stream], item, array, intrinsics=prefix == INTRINSICS)
    return None, item


def _fitted_to_images(
    stream: StreamView, item: CalibrationItem, array: np.ndarray | None, *, intrinsics: bool
) -> tuple[str | None, CalibrationItem]:
    images = images_of(stream.metadata)
    if images is None:
        return "the stream has no images", item
    if intrinsics:
        try:
            camera = Intrinsics.model_validate(item.value)
            camera = fitting(camera, images.width, images.height, None)
        except (ValidationError, UsageError) as error:
            return str(error).splitlines()[0], item
        return None, item.model_copy(update={"value": dump(camera)})
    size = (images.height, images.width)
    if array is None or array.shape[:2] != size or array.ndim != 3:
        found = "no array" if array is None else f"an array of {array.shape}"
        return f"{found} for images of {size[0]}x{size[1]}", item
    return None, item


def _same(episode: Episode, name: str, item: CalibrationItem, array: np.ndarray | None) -> bool:
    there = episode.metadata.calibration.get(name)
    if there is None or dump(there) != dump(item):
        return False
    return array is None or np.array_equal(episode.calibration_array(name), array)


def _retimed(stream: StreamView, item: CalibrationItem, plan: _Plan) -> str | None:
    """Plan a stream's new times; return why there can be none."""
    clock = stream.metadata.clock
    latency = item.value
    reason = _no_latency(item)
    if reason is not None:
        return reason
    later = _with_latency(clock, latency, item)
    if later == clock:
        return None
    if latency == clock.latency_ns:
        plan.change(stream.name, {}, clock=later)
        return None
    raw = _raw_times(stream)
    if raw is not None:
        if not _follows(stream, raw):
            return "the stream's times are not what its clock makes of its raw times"
        time, nudged = strictly_increasing(_computed(raw, later))
        changed = {"time": time, **_marked(stream, "time_nudged", nudged)}
    elif isinstance(images_of(stream.metadata), VideoImages):
        # The raw times are the presentation times, and a latency is subtracted from what they give.
        changed = {"time": stream.time + np.int64(clock.latency_ns - latency)}
    else:
        return "the stream has no raw times to compute its times from"
    plan.change(stream.name, changed, clock=later)
    return None


def _no_latency(item: CalibrationItem) -> str | None:
    """Return why an item is no latency, or None."""
    latency = item.value
    if isinstance(latency, bool) or not isinstance(latency, int) or item.unit != "ns":
        return "its value is no whole number of ns"
    if abs(latency) > _MOST_LATENCY_NS:
        return f"{latency * 1e-9:g} s are no latency"
    return None


def _move_along(episode: Episode, stream: StreamView, plan: _Plan) -> None:
    """Plan the new times of a clip that was placed by poses whose latency is another one now."""
    pose = placed_by(stream.metadata.clock)
    if pose is None or pose not in episode:
        return
    before = episode[pose].metadata.clock
    after = plan.fields.get(pose, {}).get("clock", before)
    if after == before:
        return
    earlier = after.latency_ns - before.latency_ns
    clock = plan.fields.get(stream.name, {}).get("clock", stream.metadata.clock)
    power = (clock.offset_sigma_ns or 0.0) ** 2
    power += (after.latency_sigma_ns or 0.0) ** 2 - (before.latency_sigma_ns or 0.0) ** 2
    terms: dict[str, int] = {"offset_sigma_ns": round(math.sqrt(max(power, 0.0)))}
    if clock.raw_time is not None or isinstance(images_of(stream.metadata), VideoImages):
        terms["offset_ns"] = clock.offset_ns - earlier
    later = clock.model_copy(update=terms)
    changed = {}
    if earlier:
        time = plan.arrays.get(stream.name, {}).get("time", stream.time)
        changed["time"] = time - np.int64(earlier)
    plan.change(stream.name, changed, clock=later)


def _follows(stream: StreamView, raw_ns: np.ndarray) -> bool:
    """Whether a stream's times are what its clock makes of raw times, but for nudged ones."""
    off = np.abs(_computed(raw_ns, stream.metadata.clock) - stream.time) > 1
    marks = stream.flags
    if marks is not None:
        off &= (marks & flags()["time_nudged"].mask) == 0
    return not off.any()


def _with_latency(clock: Clock, latency_ns: int, item: CalibrationItem) -> Clock:
    """Return a clock with another latency; what is said of its offset and drift stays."""
    before = (clock.method or "").split("; latency: ")[0]
    said = [before] if before.startswith("clock: ") else []
    if not said and before and (clock.drift_ppm or clock.offset_ns):
        said = [f"clock: {before}"]
    told = item.method or item.procedure
    parts = [*said, *([f"latency: {told}"] if told else [])]
    return clock.model_copy(
        update={
            "latency_ns": latency_ns,
            "latency_sigma_ns": item.uncertainty,
            "method": "; ".join(parts) or None,
        }
    )


def _raw_times(stream: StreamView) -> np.ndarray | None:
    """Return the raw times that a stream's times were computed from, ns."""
    source = stream.metadata.clock.raw_time
    if source == "time_host":
        return stream.time_host
    if source == "time_device":
        unit = units().get(stream.metadata.time_device_unit or "")
        scale = None if unit is None else unit.ns
        raw = stream.time_device
        return None if raw is None or scale is None else raw * np.int64(scale)
    return None


def _computed(raw_ns: np.ndarray, clock: Clock) -> np.ndarray:
    return apply_clock(
        raw_ns,
        t_ref=clock.t_ref_ns,
        drift_ppm=clock.drift_ppm,
        offset_ns=clock.offset_ns,
        latency_ns=clock.latency_ns,
    )


def _marked(stream: StreamView, flag: str, where: np.ndarray) -> dict[str, np.ndarray]:
    """Return flags with one of them set just there; nothing where they are so already."""
    mask = np.uint32(flags()[flag].mask)
    there = stream.flags
    if there is None:
        return (
            {"flags": np.where(where, mask, np.uint32(0)).astype(np.uint32)} if where.any() else {}
        )
    marked = np.where(where, there | mask, there & ~mask).astype(np.uint32)
    return {} if np.array_equal(marked, there) else {"flags": marked}


def _remap(episode: Episode, wanted: dict[str, CalibrationItem], plan: _Plan) -> None:
    """Plan the new widths of all streams; leave out the maps that none of them is by."""
    named = {}
    for stream in episode.streams.values():
        described = getattr(stream.metadata, "raw", None)
        if isinstance(stream.metadata, WidthStream) and described is not None:
            named[stream.name] = described.transform or WIDTH_MAP
            if named[stream.name] in wanted:
                _remapped(stream, described, wanted, plan)
    for name, item in list(wanted.items()):
        if (
            named
            and name not in named.values()
            and isinstance(read_width_map(item.value), WidthMap)
        ):
            others = ", ".join(f"{stream!r} is by {by!r}" for stream, by in named.items())
            plan.left_out[name] = f"no width is by a map of this name: {others}"
            del wanted[name]


def _remapped(
    stream: StreamView, described: RawData, wanted: dict[str, CalibrationItem], plan: _Plan
) -> None:
    """Plan a stream's new widths by the map that is among the items."""
    raw = stream.raw
    if raw is None:
        return
    name = described.transform or WIDTH_MAP
    item = wanted[name]
    stated_modulus = item.value.get("modulus") if isinstance(item.value, dict) else None
    modulus = described.modulus or (None if _has_turns(raw) else stated_modulus)
    stated = read_width_map(item.value, modulus)
    if not isinstance(stated, WidthMap):
        plan.left_out[name] = stated
        del wanted[name]
        return
    data, outside = stated.widths(raw, modulus)
    changed: dict[str, np.ndarray] = {}
    if not np.array_equal(data, stream.data):
        changed["data"] = data
        plan.out_of_range[stream.name] = int(np.count_nonzero(outside))
        # Flags may have been changed with the times already.
        before = plan.arrays.get(stream.name, {}).get("flags")
        changed.update(_marked(stream, "out_of_range", outside))
        changed.update(_made_valid(stream, changed.get("flags", stream.flags)))
        if before is not None and "flags" in changed:
            nudged = np.uint32(flags()["time_nudged"].mask)
            changed["flags"] = (changed["flags"] & ~nudged) | (before & nudged)
    later = described.model_copy(update={"transform": name, "modulus": modulus})
    if changed or later != described:
        plan.change(stream.name, changed, raw=later)


def _made_valid(stream: StreamView, marks: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return flags without `invalid` where that was only said because there was no map."""
    before = stream.flags
    if before is None or marks is None:
        return {}
    invalid, outside = (np.uint32(flags()[name].mask) for name in ("invalid", "out_of_range"))
    both = (before & (invalid | outside)) == (invalid | outside)
    unknown = both & ~np.isfinite(stream.data)
    return {"flags": np.where(unknown, marks & ~invalid, marks)} if unknown.any() else {}


def _has_turns(raw: np.ndarray) -> bool:
    """Whether counts are recorded with their turns: those that wrap are not negative."""
    return raw.dtype.kind == "i"


def _write(
    path: Path,
    episode: Episode,
    calibration: Calibration,
    plan: _Plan,
    source: str,
    *,
    durable: bool,
) -> None:
    metadata = episode.metadata.model_copy(deep=True)
    metadata.revision += 1
    metadata.calibration.update(plan.items)
    names = [*plan.items] or ["times and widths"]
    note = QualityNote(
        code=NOTE,
        message=f"{', '.join(names)} from {source}",
        severity="info",
    )
    mapped = {name for name, arrays in plan.arrays.items() if "data" in arrays}
    metadata.quality = [
        *(
            n
            for n in metadata.quality
            if n.code != NOTE and not (n.code == NOT_CALIBRATED and n.stream in mapped)
        ),
        note,
    ]
    arrays = {name: calibration.arrays[name] for name in plan.items if name in calibration.arrays}
    replaced = {f"calibration/{name}" for name in plan.items}
    with EpisodeWriter(path, metadata, overwrite=True, durable=durable) as writer:
        for name in episode.streams:
            writer.copy_stream(
                episode, name, changed=plan.arrays.get(name), **plan.fields.get(name, {})
            )
        writer.copy_group(episode, "calibration", without=replaced)
        writer.copy_group(episode, "annotations")
        for name, values in arrays.items():
            writer.add_calibration_array(name, values)
        writer.copy_derived(episode)  # nothing is derived from times or widths


def named(path: Path) -> str:
    """Return a calibration file's name and digest, by which an episode's note tells it.

    Parameters
    ----------
    path : pathlib.Path
    """
    return f"{path.name} (sha-256 {hashlib.sha256(path.read_bytes()).hexdigest()})"
