"""Cases of signal quality: calibration."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import EXUMI, Case, Finding, case
from corpus.draft import Draft
from corpus.valid_combinations import mapped as rectified

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
    yield from _rectification_cases()
    yield from _lens_cases()


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

    about = "A map over more counts than a turn has, of counts that wrap."
    yield case("CAL-005__beyond_a_turn", about, spoiled([3900, 6000, 8100]), at)

    def followed(name: str, about: str, widths: list[float], index: int) -> Case:
        draft = bases.mapped()
        draft.put("streams/width/data", np.array(widths, dtype=np.float32))
        return case(name, about, draft, Finding("CAL-006", "streams/width/data", index=index))

    about = "Widths of twice what their counts stand for."
    yield followed("CAL-006__doubled", about, [0.0, 0.0196, 0.0392, 0.0996], 1)
    about = "Centimetres in place of metres."
    yield followed("CAL-006__centimetres", about, [0.0, 0.98, 1.96, 4.98], 1)


def _rectification_cases() -> Iterator[Case]:
    path = "calibration/rectification/tactile"
    item = f"{EXUMI}/calibration/rectification~1tactile"
    about = "A map that shows a row below the image."
    outside = rectified()
    index = outside.values[path].copy()
    index[2, 3, 0] = len(index)
    outside.put(path, index, names=("y", "x", "index"))
    yield case("CAL-007__outside", about, outside, Finding("CAL-007", path))
    other = rectified()
    other.put(path, other.values[path][:8], names=("y", "x", "index"))
    about = "A map for images of half the height."
    yield case("CAL-007__half", about, other, Finding("CAL-007", path))
    crop = rectified()
    crop.metadata["calibration"]["rectification/tactile"]["value"]["crop_px"] = [17, 8]
    about = "A crop higher than the image."
    yield case("CAL-007__crop", about, crop, Finding("CAL-007", path))
    scale = rectified()
    scale.metadata["calibration"]["rectification/tactile"]["value"]["mm_per_px"] = 0.05
    at = Finding("CAL-007", ROOT, f"{item}/value")
    yield case("CAL-007__one_scale", "A map with one scale for two axes.", scale, at)


def _lens_cases() -> Iterator[Case]:
    def lens(name: str, about: str, **changes: Any) -> Case:
        draft = rectified()
        draft.metadata["calibration"]["intrinsics/wide"]["value"].update(changes)
        at = Finding("CAL-008", ROOT, f"{EXUMI}/calibration/intrinsics~1wide/value")
        return case(name, about, draft, at)

    yield lens("CAL-008__other_size", "Intrinsics of the camera's full images.", width=2704)
    yield lens("CAL-008__two_terms", "A fisheye with two coefficients.", distortion=[0.1, 0.2])
    yield lens("CAL-008__lens", "A lens that OpenCV does not know.", model="omnidirectional")
