"""Sequence numbers of datagrams."""

from hypothesis import given
from hypothesis import strategies as st

from exumi_recorders.drivers.quest_sequence import SequenceWatch

MS = 1_000_000
M = 2**32


def orders(watch: SequenceWatch, numbers: list[int]) -> list[str]:
    return [watch.take(number % M, number * 11 * MS) for number in numbers]


def test_lost_late_and_twice() -> None:
    watch = SequenceWatch(M)
    found = orders(watch, [5, 6, 9, 7, 9, 7, 10])
    assert found == ["next", "next", "next", "late", "twice", "twice", "next"]
    assert (watch.lost, watch.late, watch.twice, watch.restarts) == (1, 1, 2, 0)


def test_what_came_before_the_first_was_never_lost() -> None:
    watch = SequenceWatch(M)
    assert orders(watch, [5, 8, 4, 6]) == ["next", "next", "late", "late"]
    assert watch.lost == 1


def test_the_wrap_is_no_loss() -> None:
    watch = SequenceWatch(M)
    assert orders(watch, [M - 2, M - 1, M, M + 1]) == ["next"] * 4
    assert watch.lost == 0


def test_an_app_that_starts_again_is_believed() -> None:
    watch = SequenceWatch(M)
    assert [watch.take(n, 1000 + n) for n in range(500)] == ["next"] * 500
    assert watch.take(0, 5000) == "restart"
    assert watch.take(1, 5001) == "next"
    assert watch.take(0, 5000) == "twice"
    assert (watch.lost, watch.restarts) == (0, 1)


def test_what_may_still_come_is_not_counted_as_lost_for_good() -> None:
    watch = SequenceWatch(M)
    orders(watch, [0, 3])
    assert (watch.lost, watch.settled) == (2, 0)
    orders(watch, [1])
    assert watch.lost == 1
    orders(watch, list(range(4, 34)))
    assert watch.settled == 0, "2 is 31 behind the newest"
    orders(watch, [34])
    assert (watch.lost, watch.settled) == (1, 1)
    orders(watch, [2])
    assert (watch.lost, watch.late, watch.settled) == (0, 2, 1), "it is not taken back"
    orders(watch, [5000])
    assert watch.settled == watch.lost - 31 == 5000 - 34 - 1 - 31


def test_a_headset_that_starts_again_is_believed() -> None:
    watch = SequenceWatch(M)
    assert watch.take(700, 60_000 * MS) == "next"
    assert watch.take(0, 100 * MS) == "restart"
    assert watch.take(5000, 200 * MS) == "next"
    assert watch.take(3000, 150 * MS) == "restart", "further back than what is remembered"


@given(
    st.lists(st.booleans(), min_size=1, max_size=90),
)
def test_what_is_lost_is_counted_whatever_the_order(arrives: list[bool]) -> None:
    numbers = [i for i, kept in enumerate(arrives) if kept]
    if not numbers:
        return
    swapped = numbers.copy()
    for i in range(0, len(swapped) - 2, 3):  # the first stays the first
        swapped[i + 1], swapped[i + 2] = swapped[i + 2], swapped[i + 1]
    watch = SequenceWatch(M)
    settled = [0]
    for number in swapped:
        orders(watch, [number])
        settled.append(watch.settled)
    assert settled == sorted(settled)
    assert watch.lost == numbers[-1] - numbers[0] + 1 - len(numbers)
    assert watch.restarts == watch.twice == 0
