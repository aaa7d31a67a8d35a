"""Calibration: that it is there, of the time of the recording, known somehow, and was used."""

from collections.abc import Iterator
from datetime import date

import numpy as np

from exumi_data.model.description import CalibrationItem
from exumi_data.model.streams import PoseStream, WidthStream, WrenchStream
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.document_rules import is_real_date
from exumi_validators.findings import problem
from exumi_validators.raw_to_data import KEY, RawToData, read_map
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped
from exumi_validators.series import read_series

__all__ = ["dated", "explained", "followed", "mapped", "transforms"]

_DAY = len("2026-01-01")


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
    for _, _, key, stated in _width_maps(episode):
        if key is not None and isinstance(stated, str):
            pointer = (*EXUMI, "calibration", key, "value", KEY)
            yield problem("CAL-005", ROOT, pointer=pointer, found=key, detail=stated)


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
        yield Skipped("CAL-006", "no raw value lies on the calibration's map", path)
