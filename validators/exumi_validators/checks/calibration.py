"""Calibration: that it is there, of the time of the recording, known somehow, and was used."""

import math
from collections.abc import Iterator
from datetime import date
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from exumi_data.errors import ExumiError
from exumi_data.model.base import Model
from exumi_data.model.calibration import INTRINSICS, RECTIFICATION, Intrinsics, Rectification
from exumi_data.model.description import CalibrationItem
from exumi_data.model.images import Images
from exumi_data.model.streams import PoseStream, WidthStream, WrenchStream, images_of
from exumi_data.raw_to_data import KEY, RawToData, read_map
from exumi_data.tactile.rectification import PixelMap
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.document_rules import is_real_date
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped
from exumi_validators.series import read_series

__all__ = [
    "dated",
    "explained",
    "followed",
    "intrinsics",
    "mapped",
    "rectification",
    "transforms",
]

_DAY = len("2026-01-01")
_MOST_MAP_BYTES = 64 << 20

M = TypeVar("M", bound=Model)


@check("CAL-002")
def transforms(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a stream with raw values names what leads from them to its data."""
    for name, stream in episode.streams.items():
        if not isinstance(stream, PoseStream | WidthStream | WrenchStream):
            continue
        if stream.raw is not None and stream.raw.transform is None:
            yield problem("CAL-002", ROOT, pointer=(*EXUMI, "streams", name, "raw"))


@check("CAL-003")
def dated(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that calibrations were made shortly before the recording."""
    start = _date(episode.section("start"))
    before, after = (episode.limit("CAL-003", name) for name in ("before_days", "after_days"))
    for pointer, item in episode.parts(CalibrationItem, "calibration"):
        made = _date(item.time)
        if start is None or made is None:
            missing = "the calibration's" if start is not None else "the recording's"
            yield Skipped("CAL-003", f"{missing} date is not known", ROOT)
            continue
        age_days = (start - made).days
        if not -after <= age_days <= before:
            yield problem(
                "CAL-003",
                ROOT,
                pointer=(*pointer, "time"),
                expected=episode.section("start"),
                found=item.time,
            )


def _date(text: str | None) -> date | None:
    if text is None or not is_real_date(text):
        return None
    return date.fromisoformat(text[:_DAY])


@check("CAL-004")
def explained(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a calibration says how it was had, or how exact it is."""
    for pointer, item in episode.parts(CalibrationItem, "calibration"):
        said = (item.method, item.procedure, item.uncertainty, item.residual)
        if all(value in (None, "") for value in said):
            yield problem("CAL-004", ROOT, pointer=pointer, found=str(pointer[-1]))


def _width_maps(
    episode: EpisodeContext,
) -> Iterator[tuple[str, WidthStream, str | None, RawToData | str | None]]:
    """Go through the widths: name, stream, name of the calibration item, and what map it states."""
    items = {pointer[-1]: item for pointer, item in episode.parts(CalibrationItem, "calibration")}
    for name, stream in episode.streams.items():
        if isinstance(stream, WidthStream):
            key = stream.raw.transform if stream.raw else None
            item = None if key is None else items.get(key)
            yield name, stream, key, None if item is None else read_map(item.value)


@check("CAL-005")
def mapped(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a map from raw values to widths is one."""
    for _, stream, key, stated in _width_maps(episode):
        detail = stated
        if isinstance(stated, RawToData):
            detail = stated.beyond_a_turn(stream.raw.modulus if stream.raw else None)
        if key is not None and detail is not None:
            pointer = (*EXUMI, "calibration", key, "value", KEY)
            yield problem("CAL-005", ROOT, pointer=pointer, found=key, detail=detail)


@check("CAL-006")
def followed(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that widths are what their calibration makes of the raw values."""
    for name, stream, _, stated in _width_maps(episode):
        path = f"streams/{name}/data"
        if not isinstance(stated, RawToData):
            yield Skipped("CAL-006", f"no calibration of the width states `{KEY}`", path)
        elif episode.reader(f"streams/{name}/raw") is not None:
            modulus = stream.raw.modulus if stream.raw else None
            yield from _off_the_map(episode, name, stated, modulus)


def _off_the_map(
    episode: EpisodeContext, name: str, stated: RawToData, modulus: int | None
) -> Iterator[Finding]:
    path = f"streams/{name}/data"
    tolerance = episode.limit("CAL-006", "share_of_map") * stated.span
    first: tuple[int, float, float] | None = None
    judged = count = 0
    for series in read_series(episode, name, "data", "raw"):
        own = series.own_samples
        widths = series.values[0][own]
        expected = stated.at(series.values[1][own], modulus)
        there = series.usable[own] & np.isfinite(expected)
        # Data is float32, and so is what it is compared with.
        off = there & (np.abs(widths - expected.astype(widths.dtype)) > tolerance)
        judged += int(there.sum())
        count += int(off.sum())
        if first is None and off.any():
            row = int(off.argmax())
            first = series.start + own.start + row, float(widths[row]), float(expected[row])
    if first is not None:
        index, width, meant = first
        found, expected_width = f"{width:.4g}", f"{meant:.4g}"
        yield problem(
            "CAL-006",
            path,
            index=index,
            expected=expected_width,
            found=found,
            count=count,
            judged=judged,
        )
    elif not judged:
        yield Skipped("CAL-006", "no readable raw value lies on the calibration's map", path)


@check("CAL-007")
def rectification(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that the maps by which tactile frames are rectified fit them."""
    for pointer, item in episode.parts(CalibrationItem, "calibration"):
        name = str(pointer[-1])
        if not name.startswith(RECTIFICATION):
            continue
        images = _images(episode, name.removeprefix(RECTIFICATION))
        if images is None:
            yield Skipped("CAL-007", "no stream of images of that name", ROOT)
            continue
        value, mistake = _value(episode, item.value, Rectification)
        if value is None:
            yield problem("CAL-007", ROOT, pointer=(*pointer, "value"), detail=mistake)
            continue
        path = f"calibration/{name}"
        if item.array != path:
            detail = f"`array` is not {path}"
            yield problem("CAL-007", ROOT, pointer=pointer, detail=detail)
            continue
        found = _map(episode, path, (images.height, images.width, 2))
        if isinstance(found, str):
            yield problem("CAL-007", path, detail=found)
        elif found is not None:
            try:
                PixelMap(found, (*value.centre_px,), (*value.crop_px,))  # type: ignore[arg-type]  # two each, by the model
            except ValueError as error:
                yield problem("CAL-007", path, detail=str(error))


def _map(
    episode: EpisodeContext, path: str, shape: tuple[int, ...]
) -> npt.NDArray[np.uint16] | str | None:
    """Return a map, or what is wrong with it; None where it cannot be read: other rules say why."""
    reader = episode.reader(path) if path in episode.expected_arrays else None
    if reader is None:
        return None
    if reader.shape != shape or reader.dtype != np.uint16:
        return f"it is {reader.shape} {reader.dtype}, not {shape} uint16"
    if math.prod(shape) * 2 > _MOST_MAP_BYTES:
        return None
    try:
        return np.asarray(reader.rows(0, shape[0]), np.uint16)
    except (ExumiError, OSError):
        return None


@check("CAL-008")
def intrinsics(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that intrinsics are whole, and for images of the size that is stored."""
    for pointer, item in episode.parts(CalibrationItem, "calibration"):
        name = str(pointer[-1])
        if not name.startswith(INTRINSICS):
            continue
        images = _images(episode, name.removeprefix(INTRINSICS))
        if images is None:
            yield Skipped("CAL-008", "no stream of images of that name", ROOT)
            continue
        value, mistake = _value(episode, item.value, Intrinsics)
        if value is not None and (value.width, value.height) != (images.width, images.height):
            mistake = (
                f"they are for {value.width}x{value.height} pixels, the images have "
                f"{images.width}x{images.height}"
            )
        if mistake:
            yield problem("CAL-008", ROOT, pointer=(*pointer, "value"), detail=mistake)


def _images(episode: EpisodeContext, stream: str) -> Images | None:
    model = episode.streams.get(stream)
    return None if model is None else images_of(model)


def _value(episode: EpisodeContext, value: object, model: type[M]) -> tuple[M | None, str]:
    """Return the value of an item, or what is wrong with it."""
    try:
        return model.model_validate(value, context={"newer_minor": episode.newer}), ""
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        return None, f"{place}: {first['msg']}" if place else str(first["msg"])
