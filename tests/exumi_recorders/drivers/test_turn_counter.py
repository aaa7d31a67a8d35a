"""Turns of an encoder: counted from home, lost where it could not be followed."""

from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_recorders.drivers.turn_counter import TurnCounter

MS = 1_000_000


def rested(home: int = 100, at: int | None = None) -> TurnCounter:
    """One that has rested at home until 600 ms."""
    turns = TurnCounter(home, 4096)
    for i in range(61):
        turns.take((home if at is None else at) % 4096, 10 * i * MS)
    return turns


def followed(turns: TurnCounter, counts: Iterable[int], start_ms: int = 610) -> list[int]:
    return [turns.take(count % 4096, (start_ms + 10 * i) * MS) for i, count in enumerate(counts)]


@settings(max_examples=50)
@given(home=st.integers(0, 4095), steps=st.lists(st.integers(-1000, 1000), max_size=60))
def test_counts_go_on(home: int, steps: list[int]) -> None:
    turns = rested(home)
    true = [home]
    for step in steps:
        true.append(true[-1] + step)
    assert followed(turns, true) == true
    assert turns.is_known


def test_home_may_lie_at_the_encoders_end() -> None:
    turns = rested(home=4094, at=4099)  # it says 3
    assert turns.is_known
    assert followed(turns, [4099, 4200]) == [4099, 4200]


def test_it_is_not_known_before_it_rested_at_home() -> None:
    turns = TurnCounter(100, 4096)
    assert followed(turns, [2000] * 100, start_ms=0) == [2000] * 100
    assert not turns.is_known
    followed(turns, [100] * 40, start_ms=1000)
    followed(turns, [400], start_ms=1400)  # that was on the way through
    followed(turns, [100] * 40, start_ms=1410)
    assert not turns.is_known
    followed(turns, [100] * 20, start_ms=1810)
    assert turns.is_known


@pytest.mark.parametrize(
    ("counts", "start_ms"),
    [([100], 700), ([1300], 610)],
    ids=["not seen for 100 ms", "too fast to be followed"],
)
def test_where_it_could_not_be_followed_the_turn_is_lost(counts: list[int], start_ms: int) -> None:
    turns = rested()
    followed(turns, counts, start_ms)
    assert not turns.is_known
    followed(turns, [100] * 61, start_ms + 10)
    assert turns.is_known


def test_it_is_lost_where_somebody_says_so() -> None:
    turns = rested()
    turns.lose()
    assert not turns.is_known
    assert followed(turns, [3000]) == [3000 - 4096]  # the nearest to home
