"""Items made by another thread: in order, no more ahead than told, errors where they are taken."""

import threading
import time
from collections.abc import Generator, Iterator

import pytest

from exumi_data.ahead import ahead


def test_items_come_in_order() -> None:
    assert list(ahead(range(100), most=3)) == list(range(100))
    assert list(ahead([])) == []


def test_another_thread_makes_them() -> None:
    def whose() -> Iterator[int]:
        yield threading.get_ident()

    assert list(ahead(whose())) != [threading.get_ident()]


def test_no_more_wait_than_told() -> None:
    made: list[int] = []

    def items() -> Iterator[int]:
        for number in range(50):
            made.append(number)
            yield number

    taken = ahead(items(), most=2)
    assert next(taken) == 0
    time.sleep(0.1)
    # Two wait, and one more is in the hand of the other thread.
    assert len(made) <= 4
    taken.close()


def test_an_error_comes_after_the_items_before_it() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise OSError("the disk is gone")

    taken = ahead(items())
    assert next(taken) == 1
    with pytest.raises(OSError, match="the disk is gone"):
        next(taken)


def test_closing_ends_the_thread_and_the_source() -> None:
    ended = threading.Event()

    def items() -> Generator[int, None, None]:
        try:
            yield from range(10**9)
        finally:
            ended.set()

    before = threading.active_count()
    source = items()
    taken = ahead(source)
    next(taken)
    taken.close()
    assert threading.active_count() == before
    source.close()
    assert ended.is_set()
