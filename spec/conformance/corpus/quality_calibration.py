"""Cases of signal quality: calibration."""

from collections.abc import Iterator
from typing import Any

from corpus import bases
from corpus.case import EXUMI, Case, Finding, case

__all__ = ["calibration_cases"]

ROOT = "zarr.json"
ENCODER = f"{EXUMI}/calibration/encoder"


def calibration_cases() -> Iterator[Case]:
    """Return the cases."""
    draft = bases.widths()
    del draft.metadata["streams"]["width"]["raw"]["transform"]
    at = Finding("CAL-002", ROOT, f"{EXUMI}/streams/width/raw")
    yield case("CAL-002__counts", "Counts, and no word of how they became widths.", draft, at)

    def dated(name: str, about: str, time: str) -> Case:
        changed: dict[str, Any] = {"start": "2026-05-04T10:20:30Z"}
        draft = bases.widths(**changed)
        draft.metadata["calibration"]["encoder"]["time"] = time
        return case(name, about, draft, Finding("CAL-003", ROOT, f"{ENCODER}/time"))

    yield dated("CAL-003__old", "A calibration of last year.", "2025-05-04T10:20:30Z")
    yield dated("CAL-003__later", "A calibration of two days later.", "2026-05-06T09:00:00Z")
    draft = bases.widths()
    del draft.metadata["calibration"]["encoder"]["uncertainty"]
    at = Finding("CAL-004", ROOT, ENCODER)
    yield case("CAL-004__bare", "A calibration that fell from the sky.", draft, at)
