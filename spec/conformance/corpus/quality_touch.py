"""Cases of signal quality: touch."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import Case, Finding, case
from corpus.datasets import EGG, RICE, dataset, place
from corpus.draft import Draft

__all__ = ["touch_cases"]

OLD_GEL = "018f0000-0000-7000-8000-0000000000c3"
NEW_GEL = "018f0000-0000-7000-8000-0000000000d4"
SIDE = 24
FRAMES = 40
NAME = "tactile"
DATA = f"streams/{NAME}/data"
REFERENCE = f"streams/{NAME}/reference"
ACTIVITY = f"derived/{NAME}/activity"
AXES = ("y", "x", "channel")
_PARAMETERS = {"threshold": 5.8, "size": 224, "active_above": 0.001}


def _gel(seed: int = 1) -> np.ndarray:
    """Return a gel with a pattern of its own, (SIDE, SIDE, 1) uint8."""
    return np.random.default_rng(seed).integers(80, 140, (SIDE, SIDE, 1)).astype(np.uint8)


def _press(gel: np.ndarray) -> np.ndarray:
    """Return frames of a gel that is pressed in the second half, each with noise of its own."""
    noise = np.random.default_rng(0).integers(0, 3, (FRAMES, SIDE, SIDE, 1)).astype(np.uint8)
    frames: np.ndarray = gel + noise
    frames[FRAMES // 2 :, 8:16, 8:16] += 40
    return frames


def _stream(
    draft: Draft, frames: np.ndarray, reference: np.ndarray, name: str = NAME, **fields: Any
) -> None:
    images = {"encoding": "array", "height": SIDE, "width": SIDE, "channels": frames.shape[3]}
    draft.stream(name, "tactile", images=images, reference={"method": "captured"}, **fields)
    names = ("time", *AXES)
    draft.put(f"streams/{name}/time", bases.times(len(frames)))
    draft.put(f"streams/{name}/data", frames, names=names, chunk_rows=1, zstd=False)
    draft.put(f"streams/{name}/reference", reference, names=AXES)


def _episode(frames: np.ndarray, reference: np.ndarray, **metadata: Any) -> Draft:
    draft = Draft(**metadata)
    _stream(draft, frames, reference)
    return draft


def _active(share: float, regime: str) -> Draft:
    """Return an episode with a share of active frames."""
    draft = _episode(_press(_gel()), _gel(), regime=regime)
    activity = np.zeros(FRAMES, np.float32)
    activity[: round(share * FRAMES)] = 0.25
    draft.derive(
        f"{NAME}/activity",
        activity,
        names=("time",),
        algorithm="exumi-activity/1",
        parameters=_PARAMETERS,
        inputs=[DATA, REFERENCE],
    )
    return draft


def _activity_cases() -> Iterator[Case]:
    at = Finding("TACT-004", ACTIVITY)
    yield case("TACT-004__half", "Play that is half contact.", _active(0.5, "play"), at)
    at = Finding("TACT-005", ACTIVITY)
    draft = _active(0.0, "demonstration")
    yield case("TACT-005__none", "A demonstration that touches nothing.", draft, at)
    draft = _active(0.9, "demonstration")
    yield case("TACT-005__nearly_all", "A demonstration in contact nearly throughout.", draft, at)
    draft = _active(1.0, "play")
    draft.put(f"streams/{NAME}/time", bases.times(FRAMES, 600_000_000))
    at = Finding("TACT-013", ACTIVITY)
    about = "Play of 23 s in which the sensor never comes to rest."
    yield case("TACT-013__never_quiet", about, draft, at)


def _frame_cases() -> Iterator[Case]:
    gel = _gel()
    draft = _episode(_press(gel), gel - np.uint8(30))
    at = Finding("TACT-006", REFERENCE)
    yield case("TACT-006__other_light", "A reference that was taken in less light.", draft, at)
    frames = _press(gel)
    frames[8:25, :12] = 255
    at = Finding("TACT-007", DATA, index=8)
    yield case("TACT-007__white", "Frames of which half is white.", _episode(frames, gel), at)
    frames = _press(gel)
    frames[16:33] //= 20
    at = Finding("TACT-008", DATA, index=16)
    yield case("TACT-008__light_off", "Frames without light.", _episode(frames, gel), at)
    coarse = np.kron(_gel()[:6, :6, 0], np.ones((4, 4), np.uint8))[..., None]
    draft = _episode(_press(np.roll(coarse, 4, axis=1)), coarse)
    found = [Finding("TACT-006", REFERENCE), Finding("TACT-009", REFERENCE)]
    yield case("TACT-009__moved", "A gel that moved by four pixels.", draft, *found)
    lit = _lit_from_the_left()
    frames, at = _press(lit)[::4], Finding("TACT-014", REFERENCE)
    draft = _episode(frames, np.ascontiguousarray(lit[:, ::-1]))
    found = [Finding("TACT-009", REFERENCE), at]  # the light seems to have moved as well
    yield case("TACT-014__mirrored", "A reference that is mirrored.", draft, *found)
    draft = _episode(frames, np.ascontiguousarray(lit[..., ::-1]))
    yield case("TACT-014__bgr", "A reference that is BGR, of frames that are RGB.", draft, at)
    at = Finding("TACT-011", DATA)
    draft = _episode(*_wrapped(gel))
    yield case("TACT-011__times_seven", "Differences times seven, wrapped.", draft, at)


def _lit_from_the_left() -> np.ndarray:
    """Return a gel in red light from the left, (SIDE, SIDE, 3) uint8."""
    ramp = np.linspace(124, 108, SIDE)[:, None] * np.array([1.0, 0.9, 0.8])
    return np.tile(ramp.astype(np.uint8), (SIDE, 1, 1))


def _wrapped(gel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frames (concave, convex, grey) whose differences wrap, and their reference."""
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    depth = np.maximum(0, 60 - 4 * (np.abs(y) + np.abs(x)))
    grey = gel[..., 0]
    frames = np.zeros((12, SIDE, SIDE, 3), np.uint8)
    frames[..., 2] = grey
    frames[6:, :, :, 1] = 7 * depth % 256
    frames[:, 0, 0, 2] += np.arange(12, dtype=np.uint8)
    return frames, frames[0]


def _finger_cases() -> Iterator[Case]:
    draft = Draft()
    gels = {"left": _gel(1), "right": _gel(2)}
    for side, other in (("left", "right"), ("right", "left")):
        name, path = f"tactile_{side}", f"calibration/tactile_reference/tactile_{side}"
        _stream(draft, _press(gels[other])[:16], gels[other], name)
        calibration = draft.metadata.setdefault("calibration", {})
        calibration[f"tactile_reference/{name}"] = {
            "value": None,
            "array": path,
            "method": "captured without contact",
        }
        draft.group("calibration")
        draft.group("calibration/tactile_reference")
        draft.put(path, gels[side], names=AXES)
    found = [Finding("TACT-010", f"streams/tactile_{side}/data") for side in gels]
    yield case("TACT-010__swapped", "Two fingers under each other's name.", draft, *found)


def _gel_cases() -> Iterator[Case]:
    files = {}
    for episode_id, day, gel in ((OLD_GEL, 1, _gel()), (NEW_GEL, 2, _gel() - np.uint8(20))):
        draft = Draft(id=episode_id, start=f"2026-05-0{day}T10:00:00.000000000Z")
        sensor = {"model": "gelsight-mini", "serial": "17"}
        _stream(draft, _press(gel)[16:24], gel, sensor=sensor)
        files |= {f"{place(episode_id)}/{path}": data for path, data in draft.files().items()}
    found = Finding("TACT-012", f"{place(NEW_GEL)}/{REFERENCE}")
    about = "A sensor whose gel was changed from one day to the next."
    drop = (place(EGG), place(RICE))
    yield dataset("TACT-012__other_gel", about, found, drop=drop, add=files)


def touch_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from _activity_cases()
    yield from _frame_cases()
    yield from _finger_cases()
    yield from _gel_cases()
