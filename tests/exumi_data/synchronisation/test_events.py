"""Finding touches, and curves that are older than their times say."""

import numpy as np
import pytest

from exumi_data.synchronisation import find_touches, holding_time_s, still_touches
from tests.exumi_data.synchronisation.gripping import NS, activity, as_ns, width_m

QUIET = [0.0] * 6
TOUCH = [0.05, 0.12, 0.15, 0.15, 0.15, 0.1, 0.02]


def times(count: int) -> np.ndarray:
    return np.arange(count, dtype=np.int64) * (NS // 30)


def touches(*parts: list[float]) -> list[tuple[int, int]]:
    values = np.concatenate(parts)
    return [(touch.first, touch.last) for touch in find_touches(times(len(values)), values)]


def test_a_touch_lies_between_quiet_frames() -> None:
    assert touches(QUIET, TOUCH, QUIET) == [(6, 12)]
    assert touches(QUIET, TOUCH, QUIET, TOUCH, QUIET) == [(6, 12), (19, 25)]


def test_rise_and_fall() -> None:
    values = np.array(QUIET + TOUCH + QUIET)
    (touch,) = find_touches(times(len(values)), values)
    assert (touch.rise, touch.fall) == (slice(1, 8), slice(11, 18))
    assert touch.level == pytest.approx(0.12)


@pytest.mark.parametrize(
    "parts",
    [
        ([],),
        (QUIET * 3,),
        (TOUCH, QUIET),
        (QUIET, TOUCH),
        ([0.0], TOUCH, QUIET),
        (QUIET, [0.2, 0.2], QUIET),
        (QUIET, [0.004, 0.005, 0.005, 0.004], QUIET),
        ([0.2] * 20,),
    ],
)
def test_no_touch(parts: tuple[list[float], ...]) -> None:
    assert touches(*parts) == []


def test_a_gap_in_the_rise_is_no_touch() -> None:
    values = np.array(QUIET + TOUCH + QUIET)
    time = times(len(values))
    for index, kept in ((7, 0), (9, 1), (12, 0)):
        late = time + (np.arange(len(time)) >= index) * np.int64(NS // 4)
        assert len(find_touches(late, values)) == kept


def test_still_touches() -> None:
    time_s = np.arange(0, 8, 1 / 30)
    width_s = np.arange(0, 8, 0.005)
    found = find_touches(as_ns(time_s), activity(time_s))
    moving, resting = width_m(width_s), np.full(len(width_s), 0.04)
    assert len(found) == 2
    assert still_touches(found, as_ns(time_s), as_ns(width_s), moving) == []
    assert still_touches(found, as_ns(time_s), as_ns(width_s), resting) == found
    assert still_touches(found, as_ns(time_s), as_ns(width_s + 100), resting) == []


def test_holding_time() -> None:
    time_s = np.arange(0, 4, 0.01)
    smooth = width_m(time_s)
    held = np.repeat(smooth[::15], 15)[: len(smooth)]
    counts = np.round(smooth / 1e-3) * 1e-3
    assert holding_time_s(as_ns(time_s), smooth) < 1e-3
    assert holding_time_s(as_ns(time_s), held) == pytest.approx(0.14, rel=0.15)
    assert holding_time_s(as_ns(time_s), counts) < 1e-3
    assert holding_time_s(as_ns(time_s), np.full(len(time_s), 0.05)) == 0.0
