"""Pictures are drawn in advance, in order, and no further ahead than was asked for."""

import threading
import time

import pytest

from exumi_recorders.simulated.drawing_ahead import DrawnAhead


class Painter:
    def __init__(self, fails_at: int = -1) -> None:
        self.drawn: list[int] = []
        self._fails_at = fails_at

    def __call__(self, k: int) -> bytes:
        if k == self._fails_at:
            raise ValueError(f"frame {k}")
        self.drawn.append(k)
        return b"%d" % k


def settled(painter: Painter, count: int) -> list[int]:
    """Wait until so many are drawn, and a little longer for any that should not be."""
    end = time.monotonic() + 5
    while len(painter.drawn) < count and time.monotonic() < end:
        time.sleep(0.002)
    time.sleep(0.05)
    return painter.drawn


def test_it_stays_so_many_frames_ahead() -> None:
    painter = Painter()
    with DrawnAhead(painter, 4) as pictures:
        assert settled(painter, 4) == [0, 1, 2, 3]
        assert pictures(0) == b"0"
        assert pictures(1) == b"1"
        assert settled(painter, 5) == [0, 1, 2, 3, 4]


def test_it_goes_on_where_it_is_asked_to() -> None:
    painter = Painter()
    with DrawnAhead(painter, 2) as pictures:
        assert pictures(100) == b"100"
        assert pictures(101) == b"101"
        assert pictures(7) == b"7"
        assert pictures(8) == b"8"


def test_an_error_is_raised_where_the_picture_is_asked_for() -> None:
    with DrawnAhead(Painter(fails_at=1), 4) as pictures, pytest.raises(ValueError, match="frame 1"):
        pictures(1)


def test_its_thread_ends_with_the_block() -> None:
    with DrawnAhead(Painter(), 4):
        assert any(thread.name == "pictures" for thread in threading.enumerate())
    assert not any(thread.name == "pictures" for thread in threading.enumerate())
