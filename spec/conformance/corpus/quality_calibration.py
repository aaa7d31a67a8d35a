"""Cases of signal quality: calibration."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import EXUMI, Case, Finding, case
from corpus.draft import Draft

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
    yield from _map_cases()


def _map_cases() -> Iterator[Case]:
    def spoiled(raw: list[int]) -> Draft:
        draft = bases.mapped()
        draft.metadata["calibration"]["encoder"]["value"]["raw_to_data"]["raw"] = raw
        return draft

    at = Finding("CAL-005", ROOT, f"{ENCODER}/value/raw_to_data")
    about = "A map whose counts come in no order."
    yield case("CAL-005__not_ascending", about, spoiled([3900, 4400, 4096]), at)
    about = "A map of more counts than widths."
    yield case("CAL-005__one_too_many", about, spoiled([3900, 4096, 4400, 4500]), at)

    def followed(name: str, about: str, widths: list[float], index: int) -> Case:
        draft = bases.mapped()
        draft.put("streams/width/data", np.array(widths, dtype=np.float32))
        return case(name, about, draft, Finding("CAL-006", "streams/width/data", index=index))

    about = "Widths of twice what their counts stand for."
    yield followed("CAL-006__doubled", about, [0.0, 0.0196, 0.0392, 0.0996], 1)
    about = "Centimetres in place of metres."
    yield followed("CAL-006__centimetres", about, [0.0, 0.98, 1.96, 4.98], 1)
