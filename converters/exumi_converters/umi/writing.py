"""Format ``umi``, written: a replay buffer that UMI's and exUMI's training code reads."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from exumi_converters.exporter import ExportItem, ExportOptions, ExportPlan, Loss, Part
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.report import Failure
from exumi_converters.umi.assembling import assemble
from exumi_converters.umi.encoding import codec_config, encoder
from exumi_converters.umi.layout import TACTILE_COMBINED
from exumi_converters.umi.part import write_part
from exumi_converters.umi.reading import DEFAULT_RATE
from exumi_converters.umi.slots import (
    Slots,
    Span,
    Timeline,
    common_slots,
    find_slots,
    find_span,
    tick_times,
)
from exumi_data.calibration import rectification_of
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import ExumiError, UsageError
from exumi_data.model.streams import images_of
from exumi_data.time import format_rate, parse_rate

__all__ = ["UmiExporter", "UmiWriteOptions"]

_ROW_BYTES = 32 + 96
_BYTES_A_PIXEL = {"jpegxl": 0.1, "jpegxl-lossless": 0.45, "blosc": 0.6}
_SAME_RATE = 0.02


class UmiWriteOptions(FormatOptions):
    """What only this format can be told."""

    timeline: Literal["camera", "rate"] = Field(
        "camera",
        description="When the rows are: at the frames of the first camera, or at regular times.",
    )
    rate: str = Field(
        format_rate(DEFAULT_RATE), description="Rows a second, where they are regular."
    )
    size: int = Field(224, ge=0, le=4096, description="Edge of all images; 0: as they are.")
    crop: Literal["centre", "no"] = Field(
        "centre", description="Cut camera images to a square as UMI does, or squeeze them."
    )
    images: Literal["jpegxl", "jpegxl-lossless", "blosc"] = Field(
        "jpegxl",
        description="Codec of camera images, JPEG XL as UMI writes it; tactile images are always "
        "lossless.",
    )
    tactile: Literal["combined", "no"] = Field(
        "combined", description="exUMI's tactile_combined: concave, convex, grey of both fingers."
    )
    gaps: Literal["refuse", "longest"] = Field(
        "refuse",
        description="Episodes with holes: refuse them, or write the longest stretch without one.",
    )


class UmiExporter:
    """Every episode becomes rows of one buffer, at the frames of the first camera."""

    name = "umi"
    version = "1"
    describes = "a replay buffer of UMI and exUMI: Zarr v2 folder, or .zarr.zip by its name"
    keeps: tuple[str, ...] = (
        "camera images, end poses and widths at the times of the camera, as UMI's code reads them",
        "both tactile images as exUMI's tactile_combined, if they are there",
    )
    loses: Mapping[str, str] = {
        "identity": "rows have no ids (the root's attributes list them for people)",
        "start": "there are no times",
        "task": "there is no place for a task",
        "regime": "everything is taken for a demonstration",
        "annotations": "there is no place for them",
        "people": "there is no place for them",
        "licence": "there is no place for a licence",
        "quality": "there is no place for notes",
        "source": "there is no place for it",
        "calibration": "it is used for tactile images, and not kept",
        "streams": "only poses, widths, cameras and one pair of tactile images have a place",
        "stream-names": "robots and cameras are numbered",
        "time": "rows are at the first camera's frames, or regular, and not stamped",
        "raw-time": "there are no times",
        "clock": "there are no times",
        "flags": "rows with an invalid sample are left out, other flags dropped",
        "gaps": "an episode with holes is refused, or cut",
        "sensor": "there is no place for it",
        "values": "interpolated at the rows' times, rounded to float32, rotation as a vector",
        "raw": "there is no place for it",
        "frame-bytes": "frames are decoded and coded anew",
        "pixels": "frames are cut, resized and coded with loss; tactile ones become exUMI's "
        "channels",
        "reference": "differences are made with it; it is not kept",
        "derived": "there is no place for it",
    }
    options: type[FormatOptions] = UmiWriteOptions

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        """Choose the arrays that most episodes have, and the rows of each episode."""
        told = parse_options(UmiWriteOptions, options.settings, self.name)
        timeline = Timeline(told.timeline, _rate(told.rate))
        encoder(codec_config(told.images, tactile=False))  # finds out whether it can be had
        found, refused = _find_all(dataset, told)
        arrays = common_slots(found)
        shapes = _Shapes(told, arrays)
        items: list[ExportItem] = []
        plans: list[_Planned] = []
        for episode in dataset:
            if episode.id not in found:
                continue
            try:
                planned = _plan_one(episode, found[episode.id], shapes, timeline, told)
            except ExumiError as error:
                refused.append(Failure(episode.id, error.reason))
                continue
            index = len(items)
            items.append(ExportItem(id=episode.id, index=index, settings=planned.settings))
            plans.append(planned)
        rate = _common_rate(plans, timeline)
        notices = list(_notices(plans, rate, timeline))
        writes: Literal["file", "folder"] = "file" if destination.suffix == ".zip" else "folder"
        rows = sum(plan.rows for plan in plans)
        return ExportPlan(
            layout=f"replay buffer of {rows} rows in {len(items)} episode(s): {', '.join(arrays)}",
            items=tuple(items),
            writes=writes,
            shared={
                "timeline": told.timeline,
                "rate": format_rate(rate),
                "crop": told.crop == "centre",
                "size": told.size,
                "robots": sum(name.startswith("robot") for name in arrays),
                "images": shapes.described,
                # Whether concave and convex are ours throughout, or some came with a buffer.
                "tactile_made": not any(
                    "differences" in plan.settings["slots"]["tactile"] for plan in plans
                ),
            },
            losses=tuple(_losses(self.loses, plans, told)),
            refused=tuple(sorted(refused, key=lambda failure: failure.name)),
            notices=tuple(notices),
            estimated_bytes=rows * (_ROW_BYTES * len(arrays) + shapes.row_bytes),
        )

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        """Write the rows of one episode: numbers as arrays, coded frames end to end."""
        return write_part(item, episode, folder, plan)

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        """Copy the coded frames to their rows, and write the numbers as whole arrays."""
        assemble(parts, target, plan, about)


@dataclass(frozen=True, slots=True)
class _Planned:
    """What becomes of one episode."""

    settings: dict[str, Any]
    rows: int
    span: Span
    period_ns: float
    nominal: str | None
    left_out: tuple[str, ...]
    facets: frozenset[str]


def _rate(text: str) -> Fraction:
    try:
        return parse_rate(text)
    except ValueError as error:
        raise UsageError(f"Invalid rate ({text}): {error}") from None


def _find_all(dataset: Dataset, told: UmiWriteOptions) -> tuple[dict[str, Slots], list[Failure]]:
    found: dict[str, Slots] = {}
    refused: list[Failure] = []
    for episode in dataset:
        try:
            found[episode.id] = find_slots(episode, tactile=told.tactile == "combined")
        except ExumiError as error:
            refused.append(Failure(episode.id, error.reason))
    return found, refused


class _Shapes:
    """The images of a buffer: one shape an array, the first episode's where none is told."""

    def __init__(self, told: UmiWriteOptions, arrays: Sequence[str]) -> None:
        self._told = told
        self.arrays = tuple(arrays)
        self.described: dict[str, dict[str, Any]] = {}

    @property
    def row_bytes(self) -> int:
        """About how many bytes the frames of a row have."""
        size = 0.0
        for name, one in self.described.items():
            form = "jpegxl-lossless" if name == TACTILE_COMBINED else self._told.images
            size += float(np.prod(one["shape"])) * _BYTES_A_PIXEL[form]
        return round(size)

    def fit(self, episode: Episode, slots: Slots) -> None:
        """Check that an episode's images fit, or take theirs as the shape.

        Raises
        ------
        UsageError
            They are of another size than the first episode's, and none is told.
        """
        for name, shape in _shapes_of(episode, slots, self._told).items():
            tactile = name == TACTILE_COMBINED
            new = {
                "shape": list(shape),
                "chunk": [*shape[:2], 1 if tactile else shape[2]],
                "codec": codec_config(self._told.images, tactile=tactile),
            }
            if self.described.setdefault(name, new) != new:
                raise UsageError(
                    f"{name} would be {shape}, that of other episodes is "
                    f"{tuple(self.described[name]['shape'])}",
                    fix="Pass -o size=224, or another size.",
                )


def _shapes_of(
    episode: Episode, slots: Slots, told: UmiWriteOptions
) -> dict[str, tuple[int, int, int]]:
    shapes = {}
    for number, name in slots.cameras.items():
        images = images_of(episode[name].metadata)
        if images is None:
            raise UsageError(f"{name} has no frames")
        size = (told.size, told.size) if told.size else (images.height, images.width)
        shapes[f"camera{number}_rgb"] = (*size, 3)
    if slots.tactile:
        shapes[TACTILE_COMBINED] = (*_tactile_size(episode, slots, told.size), 3)
    return shapes


def _tactile_size(episode: Episode, slots: Slots, size: int) -> tuple[int, int]:
    sides = []
    for side in ("left", "right", "combined"):
        if side not in slots.tactile:
            continue
        view = episode[slots.tactile[side]]
        images = images_of(view.metadata)
        if images is None or (
            "reference" not in view.metadata.arrays and "differences" not in slots.tactile
        ):
            raise UsageError(
                f"{view.name} has no reference image, which differences are made with",
                fix="Run exumi prepare first, or pass -o tactile=no.",
            )
        pixel_map = rectification_of(episode, view.name) if side != "combined" else None
        sides.append((images.height, images.width) if pixel_map is None else pixel_map.crop_px)
    if size:
        return size, size
    if len(sides) == 1:
        return sides[0]
    return sides[0][1], sides[0][0] + sides[1][0]


def _plan_one(
    episode: Episode, slots: Slots, shapes: _Shapes, timeline: Timeline, told: UmiWriteOptions
) -> _Planned:
    missing = [name for name in shapes.arrays if name not in slots.arrays]
    if missing:
        raise UsageError(f"it has no {', '.join(missing)}, as most episodes have")
    extra = set(slots.arrays) - set(shapes.arrays)
    slots = _without(slots, extra)
    shapes.fit(episode, slots)
    span = find_span(episode, slots, timeline, told.gaps)
    ticks = tick_times(episode, slots, timeline)[span.first : span.stop]
    lead = episode[next(iter((slots.cameras or slots.tactile).values()))]
    used = set(slots.streams)
    return _Planned(
        settings={"slots": slots.json(), "first": span.first, "stop": span.stop},
        rows=span.stop - span.first,
        span=span,
        period_ns=float(np.median(np.diff(ticks))),
        nominal=lead.metadata.nominal_rate,
        left_out=tuple(name for name in episode.streams if name not in used),
        facets=_facets(episode, used),
    )


def _without(slots: Slots, extra: set[str]) -> Slots:
    """Drop what most episodes do not have."""
    if not extra:
        return slots

    def kept(group: Mapping[str, str], form: str) -> dict[str, str]:
        return {key: name for key, name in group.items() if form.format(key) not in extra}

    return Slots(
        poses=kept(slots.poses, "robot{}"),
        widths=kept(slots.widths, "robot{}"),
        cameras=kept(slots.cameras, "camera{}_rgb"),
        tactile={} if TACTILE_COMBINED in extra else slots.tactile,
    )


def _common_rate(plans: Sequence[_Planned], timeline: Timeline) -> Fraction:
    """Return the rate of the rows: a buffer has one.

    Raises
    ------
    UsageError
        The cameras' rates differ.
    """
    if timeline.kind == "rate" or not plans:
        return timeline.rate
    periods = [plan.period_ns for plan in plans]
    if max(periods) > (1 + _SAME_RATE) * min(periods):
        raise UsageError(
            f"the first cameras have from {1e9 / max(periods):.2f} to {1e9 / min(periods):.2f} "
            "frames/s: a replay buffer has one rate",
            fix="Pass -o timeline=rate to resample them.",
        )
    stated = {plan.nominal for plan in plans}
    if len(stated) == 1 and (only := stated.pop()) is not None:
        return Fraction(only)
    return Fraction(1_000_000_000, max(1, round(float(np.median(periods)))))


def _notices(plans: Sequence[_Planned], rate: Fraction, timeline: Timeline) -> Iterator[str]:
    cut = sum(plan.span.ticks - plan.rows for plan in plans)
    if cut:
        episodes = sum(plan.span.ticks > plan.rows for plan in plans)
        yield f"{cut} row(s) of {episodes} episode(s) are cut: not all is known there"
    if abs(float(rate / DEFAULT_RATE) - 1) > _SAME_RATE:
        way = "the first camera's frames" if timeline.kind == "camera" else "as told"
        yield (
            f"rows are {float(rate):.2f} a second ({way}): the steps in UMI's configurations are "
            "meant for 59.94"
        )


# What an episode says, by facet; anything of it is lost.
_SAID = {
    "start": ("start",),
    "annotations": ("annotations",),
    "people": ("operator", "site", "device", "embodiment"),
    "quality": ("quality",),
    "calibration": ("calibration",),
}
_ARRAYS = {
    "raw": ("raw",),
    "flags": ("flags",),
    "raw-time": ("time_host", "time_device", "sequence"),
}
_ALWAYS = ("identity", "task", "licence", "source", "stream-names", "time", "clock", "values")


def _facets(episode: Episode, used: set[str]) -> frozenset[str]:
    """Return what an episode has that a buffer does not keep."""
    found = set(_ALWAYS)
    metadata = episode.metadata
    found |= {f for f, keys in _SAID.items() if any(getattr(metadata, key) for key in keys)}
    if metadata.regime != "demonstration" or metadata.success is not None:
        found.add("regime")
    if episode.derived is not None and episode.derived.items:
        found.add("derived")
    for name in used:
        model = episode[name].metadata
        found |= {f for f, arrays in _ARRAYS.items() if set(arrays) & set(model.arrays)}
        if model.gaps or model.lost:
            found.add("gaps")
        if model.sensor is not None or model.description is not None:
            found.add("sensor")
        images = images_of(model)
        if images is not None:
            found.add("pixels")
            if images.encoding != "array":
                found.add("frame-bytes")
        if "reference" in model.arrays:
            found.add("reference")
    return frozenset(found)


def _losses(
    loses: Mapping[str, str], plans: Sequence[_Planned], told: UmiWriteOptions
) -> Iterator[Loss]:
    found = frozenset().union(*(plan.facets for plan in plans))
    lossless = told.images != "jpegxl" and not told.size
    for facet, detail in loses.items():
        if facet == "pixels" and lossless:
            yield Loss(facet=facet, detail="tactile frames become exUMI's channels")
        elif facet in found:
            yield Loss(facet=facet, detail=detail)
    for name in sorted({name for plan in plans for name in plan.left_out}):
        yield Loss(facet="streams", detail="it has no place", stream=name)
