"""Calibration: that it is there, of the time of the recording, and known somehow."""

from collections.abc import Iterator
from datetime import date

from exumi_data.model.description import CalibrationItem
from exumi_data.model.streams import PoseStream, WidthStream, WrenchStream
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.document_rules import is_real_date
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = ["dated", "explained", "transforms"]

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
