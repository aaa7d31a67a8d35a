"""Two fingers become one tactile stream, as exUMI trains on it: left | right, turned alike."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from exumi_converters.prepare_settings import PrepareSettings
from exumi_converters.prepared_one import channels_of, rectify_step, scale_of
from exumi_converters.prepared_reference import FoundReference, find_reference
from exumi_converters.prepared_stream import (
    BESIDE_TIME,
    Making,
    Measure,
    carried_fields,
    grey_step,
    images_of_view,
    jpeg_step,
    refuse_unknown_arrays,
    resize_step,
)
from exumi_converters.resize import resize
from exumi_data.calibration import rectification_of
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UsageError
from exumi_data.model import Gap, LossyStep, QualityNote, Reference, Sensor, TactileStream
from exumi_data.model.calibration import RECTIFICATION
from exumi_data.tactile import ACTIVE_THRESHOLD_COMBINED, to_grey
from exumi_data.tactile.combined import Combiner, combined_scale
from exumi_data.tactile.rectification import PixelMap
from exumi_data.time import nearest_indices

__all__ = ["Pair", "combined_making", "pairs_of"]

_SIDES = ("left", "right")
_OF_LEFT = ("clock", "nominal_rate", "time_device_unit")  # of the time, which is the left finger's
_NOT_CARRIED = {*_OF_LEFT, "gaps", "lost", "sensor"}


@dataclass(frozen=True, slots=True)
class Pair:
    """The two fingers of a gripper.

    Attributes
    ----------
    name : str
        Of the stream that they become.
    left, right : StreamView
    """

    name: str
    left: StreamView
    right: StreamView


def pairs_of(parent: Episode) -> list[Pair]:
    """Find the pairs of fingers among an episode's tactile streams.

    ``x_left`` and ``x_right`` become ``x_combined``. Two streams of other names are a pair if
    their sensors' `side` says left and right: they become ``tactile_combined``.

    Parameters
    ----------
    parent : Episode

    Raises
    ------
    UsageError
        A tactile stream has no partner, or a name contradicts what its sensor says.
    """
    views = {view.name: view for view in parent.of_kind("tactile")}
    stems = {name.rpartition("_")[0]: None for name in views if _side_in(name)}
    pairs = [
        Pair(f"{stem}_combined", views[f"{stem}_left"], views[f"{stem}_right"])
        for stem in stems
        if f"{stem}_left" in views and f"{stem}_right" in views
    ]
    if not pairs and len(views) == 2:
        by_side = {_stated_side(view): view for view in views.values()}
        if set(by_side) == set(_SIDES):
            pairs = [Pair("tactile_combined", by_side["left"], by_side["right"])]
    alone = set(views) - {view.name for pair in pairs for view in (pair.left, pair.right)}
    if alone or not pairs:
        raise UsageError(
            f"no left and right finger to combine among: {', '.join(views) or 'none'}",
            where=parent.path,
            fix="Prepare it with separate tactile images.",
        )
    for pair in pairs:
        _check_sides(parent, pair)
    return pairs


def _side_in(name: str) -> bool:
    stem, _, side = name.rpartition("_")
    return bool(stem) and side in _SIDES


def _stated_side(view: StreamView) -> str | None:
    return view.metadata.sensor.side if view.metadata.sensor else None


def _check_sides(parent: Episode, pair: Pair) -> None:
    for side, view in zip(_SIDES, (pair.left, pair.right), strict=True):
        if _stated_side(view) not in (None, side):
            raise UsageError(
                f"the sensor of {view.name!r} is said to be on the {_stated_side(view)}",
                where=parent.path,
                fix="Correct the stream's name or its `sensor.side`.",
            )
    if pair.name in parent:
        raise UsageError(f"there is a stream {pair.name!r} already", where=parent.path)


@dataclass(frozen=True, slots=True)
class _Matches:
    """Which frames are put together.

    Attributes
    ----------
    left, right : (N,) int
        Frames of the two fingers; the left ones ascend strictly, the right ones may repeat.
    within_ns : int
        How far apart they may be.
    """

    left: np.ndarray
    right: np.ndarray
    within_ns: int


def _matches(pair: Pair, settings: PrepareSettings) -> _Matches:
    """Give each frame of the left finger the nearest one of the right finger.

    No frame is made from two of one finger: that would be an image that no sensor produced.
    """
    ours, theirs = pair.left.time, pair.right.time
    within = settings.pair_within_ns
    if within is None:
        within = int(np.median(np.diff(theirs))) if len(theirs) > 1 else 0
    nearest = nearest_indices(theirs, ours, within)
    left = np.flatnonzero(nearest >= 0)
    return _Matches(left, nearest[left], within)


def combined_making(parent: Episode, pair: Pair, settings: PrepareSettings) -> Making:
    """Return how the stream of both fingers is made.

    Parameters
    ----------
    parent : Episode
    pair : Pair
    settings : PrepareSettings

    Raises
    ------
    UsageError
        The fingers do not fit together: one has a map, the other none; sizes or channels differ;
        no frame of one is near one of the other.
    MetadataError, DamagedDataError
        A calibration item is none, or its array does not fit.
    UnsupportedError
        A stream has an array of a newer version.
    """
    views = pair.left, pair.right
    for view in views:
        refuse_unknown_arrays(view)
    maps = rectification_of(parent, pair.left.name), rectification_of(parent, pair.right.name)
    height, width = _size(parent, pair, maps)
    channels = channels_of(pair.left, settings)
    if channels_of(pair.right, settings) != channels:
        raise _unfit(parent, pair, "one has colour, the other none", "Prepare them in grey.")
    matches = _matches(pair, settings)
    if not len(matches.left) and (len(pair.left) or len(pair.right)):
        reason = f"no two frames are within {matches.within_ns} ns of each other"
        raise _unfit(parent, pair, reason, "Check the fingers' clocks.")
    combiner = Combiner(*maps)
    grey = channels < images_of_view(pair.left).channels
    found = find_reference(pair.left), find_reference(pair.right)
    images = images_of_view(pair.left)
    inputs = [f"{parent.id}/streams/{v.name}/{a}" for v in views for a in ("data", "reference")]
    inputs += [f"{parent.id}/calibration/{RECTIFICATION}{v.name}" for v in views if maps[0]]
    return Making(
        name=pair.name,
        kind="tactile",
        time=pair.left.time[matches.left],
        beside=_beside(pair, matches),
        frames=lambda: _frames(views, matches, combiner, grey=grey),
        look=None,
        fit=partial(resize, size=settings.size),
        images=images,
        channels=channels,
        fields=_fields(pair, maps, matches, (height, width), settings.size),
        reference=_reference(found, combiner, grey=grey),
        about_reference=_about_reference(found),
        notes=[_renamed(f.note, pair.name) for f in found if f.note is not None],
        steps=_steps(pair, maps, matches, (height, width), settings),
        measure=Measure(active_above=ACTIVE_THRESHOLD_COMBINED, inputs=tuple(inputs)),
    )


def _unfit(parent: Episode, pair: Pair, reason: str, fix: str) -> UsageError:
    both = f"{pair.left.name!r} and {pair.right.name!r}"
    return UsageError(f"{both} cannot be combined: {reason}", where=parent.path, fix=fix)


def _size(
    parent: Episode, pair: Pair, maps: tuple[PixelMap | None, PixelMap | None]
) -> tuple[int, int]:
    """Return height and width of the combined image in the fingers' resolution."""
    if (maps[0] is None) != (maps[1] is None):
        reason = "the episode has a rectification map of one finger only"
        raise _unfit(parent, pair, reason, "Add the other map, or prepare them separately.")
    sizes = []
    for view, pixel_map in zip((pair.left, pair.right), maps, strict=True):
        images = images_of_view(view)
        sizes.append((images.height, images.width) if pixel_map is None else pixel_map.crop_px)
    if sizes[0][1] != sizes[1][1]:
        reason = f"frames of {sizes[0]} and {sizes[1]} (rows, columns) do not stand side by side"
        raise _unfit(parent, pair, reason, "Prepare them separately.")
    return sizes[0][1], sizes[0][0] + sizes[1][0]


def _frames(
    views: tuple[StreamView, StreamView], matches: _Matches, combiner: Combiner, *, grey: bool
) -> Iterator[np.ndarray]:
    left, right = views
    known, image = -1, np.empty(0, np.uint8)
    for ours, theirs in zip(matches.left.tolist(), matches.right.tolist(), strict=True):
        if theirs != known:
            known, image = theirs, right.frames.read([theirs], grey=grey)[0]
        yield combiner(left.frames.read([ours], grey=grey)[0], image)


def _renamed(note: QualityNote, stream: str) -> QualityNote:
    return note.model_copy(update={"stream": stream, "message": f"{note.stream}: {note.message}"})


def _reference(
    found: tuple[FoundReference, FoundReference], combiner: Combiner, *, grey: bool
) -> np.ndarray | None:
    left, right = (reference.image for reference in found)
    if left is None or right is None:
        return None
    if grey or left.shape[2] != right.shape[2]:
        left, right = to_grey(left)[..., None], to_grey(right)[..., None]
    return combiner(left, right)


def _about_reference(found: tuple[FoundReference, FoundReference]) -> Reference | None:
    """Say of both references what holds for both: the lesser of how they were had."""
    left, right = (reference.about for reference in found)
    if left is None or right is None:
        return None
    order = ("captured", "selected", "estimated")
    free = {left.contact_free, right.contact_free}
    return Reference(
        method=max(left.method, right.method, key=order.index),
        contact_free=False if False in free else (True if free == {True} else None),
        algorithm=left.algorithm if left.algorithm == right.algorithm else None,
    )


def _beside(pair: Pair, matches: _Matches) -> dict[str, np.ndarray]:
    """Return the arrays beside `time`: the left finger's, and the flags of both."""
    ours, theirs = pair.left.metadata.arrays, pair.right.metadata.arrays
    found = {n: pair.left.array(n)[matches.left] for n in BESIDE_TIME if n in ours}
    if "flags" in theirs:
        flags = pair.right.array("flags")[matches.right]
        found["flags"] = found["flags"] | flags if "flags" in found else flags
    return found


def _fields(
    pair: Pair,
    maps: tuple[PixelMap | None, PixelMap | None],
    matches: _Matches,
    size: tuple[int, int],
    edge: int,
) -> dict[str, Any]:
    ours, theirs = carried_fields(pair.left), carried_fields(pair.right)
    fields = {name: ours[name] for name in _OF_LEFT if name in ours}
    fields |= _alike(ours, theirs)
    sensor = _sensor(ours.get("sensor"), theirs.get("sensor"))
    gaps = _gaps(pair, matches)
    scales = [
        scale_of(view.metadata, pixel_map)
        for view, pixel_map in zip((pair.left, pair.right), maps, strict=True)
        if isinstance(view.metadata, TactileStream)
    ]
    scale = combined_scale(*scales)
    if scale is not None:
        fields["mm_per_px"] = [scale[0] * size[1] / edge, scale[1] * size[0] / edge]
    if sensor is not None:
        fields["sensor"] = sensor
    if gaps:
        fields["gaps"] = gaps
    return fields


def _alike(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the metadata of both fingers say with the same words."""
    both = (ours.keys() & theirs.keys()) - _NOT_CARRIED
    return {name: ours[name] for name in ours if name in both and ours[name] == theirs[name]}


def _sensor(left: Sensor | None, right: Sensor | None) -> Sensor | None:
    if left is None or right is None or left.model != right.model:
        return None
    return Sensor(model=left.model)


def _gaps(pair: Pair, matches: _Matches) -> list[Gap]:
    """List where frames are missing: in the left finger, or because they had no partner."""
    kept = matches.left
    # Gaps of the left finger by the kept frame that is before them.
    found: dict[int, list[Gap]] = {}
    for gap in pair.left.metadata.gaps or ():
        found.setdefault(int(np.searchsorted(kept, gap.after, side="right")) - 1, []).append(gap)
    edges = np.concatenate([[-1], kept, [len(pair.left)]])
    dropped = np.diff(edges) - 1
    places = sorted({*found, *(int(i) - 1 for i in np.flatnonzero(dropped))})
    gaps = []
    for after in places:
        own = found.get(after, [])
        lost = [int(dropped[after + 1]), *(gap.lost for gap in own)]
        reasons = [gap.reason for gap in own if gap.reason]
        if dropped[after + 1]:
            reasons.append("no frame of the other finger")
        total = None if None in lost else sum(n for n in lost if n is not None)
        gaps.append(Gap(after=after, lost=total or None, reason="; ".join(dict.fromkeys(reasons))))
    return gaps


def _steps(
    pair: Pair,
    maps: tuple[PixelMap | None, PixelMap | None],
    matches: _Matches,
    size: tuple[int, int],
    settings: PrepareSettings,
) -> list[LossyStep]:
    images, channels = images_of_view(pair.left), channels_of(pair.left, settings)
    steps: list[LossyStep | None] = [grey_step(pair.name) if channels < images.channels else None]
    for view, pixel_map in zip((pair.left, pair.right), maps, strict=True):
        if pixel_map is not None:
            steps.append(rectify_step(pair.name, view.name, pixel_map))
    steps.append(_combine_step(pair, matches))
    steps.append(resize_step(pair.name, *size, settings.size))
    steps.append(jpeg_step(pair.name, images.encoding, channels, settings))
    return [step for step in steps if step is not None]


def _combine_step(pair: Pair, matches: _Matches) -> LossyStep:
    used = np.unique(matches.right)
    unpaired = len(pair.left) - len(matches.left)
    unused = len(pair.right) - len(used)
    apart = np.abs(pair.left.time[matches.left] - pair.right.time[matches.right])
    return LossyStep(
        step="combine",
        stream=pair.name,
        detail=f"{pair.left.name} was turned left and {pair.right.name} right by 90 degrees, left "
        "beside right; each left frame was given the nearest right one, at the left one's time; "
        f"{unpaired} left frames had none within {matches.within_ns} ns and were dropped, "
        f"{unused} right frames were not used, {len(matches.left) - len(used)} used again",
        parameters={
            "left": pair.left.name,
            "right": pair.right.name,
            "pair_within_ns": matches.within_ns,
            "frames": len(matches.left),
            "left_dropped": unpaired,
            "right_unused": unused,
            "right_used_again": len(matches.left) - len(used),
            "median_apart_ns": int(np.median(apart)) if len(apart) else 0,
            "most_apart_ns": int(apart.max()) if len(apart) else 0,
        },
    )
