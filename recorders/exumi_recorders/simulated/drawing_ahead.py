"""Pictures drawn before they are due, so that a busy moment costs no frame."""

import threading
from typing import Self

from exumi_recorders.simulated.pictures import Pictures

__all__ = ["DrawnAhead"]


class DrawnAhead:
    """Pictures that a thread draws in advance, one after the other, while the block runs.

    Parameters
    ----------
    draw : callable
        Gives the file of frame k.
    depth : int
        How many frames it may be ahead of the one that was asked for last.
    """

    def __init__(self, draw: Pictures, depth: int) -> None:
        self._draw = draw
        self._depth = depth
        self._files: dict[int, bytes] = {}
        self._wanted = 0
        self._next = 0
        self._error: Exception | None = None
        self._ended = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="pictures", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join()

    def __call__(self, k: int) -> bytes:
        """Return the file of frame `k`: at once if it is drawn, else as soon as it is.

        Parameters
        ----------
        k : int
            Usually the next one; any other is where drawing goes on.
        """
        with self._changed:
            self._wanted = k
            self._files = {number: file for number, file in self._files.items() if number >= k}
            if k not in self._files and k != self._next:
                self._next = k
            self._changed.notify_all()
            self._changed.wait_for(lambda: k in self._files or self._error is not None)
            if self._error is not None:
                raise self._error
            return self._files[k]

    def _work(self) -> None:
        while (k := self._wait()) is not None:
            try:
                file = self._draw(k)
            except Exception as error:  # noqa: BLE001  # raised where the picture is asked for
                self._fail(error)
                return
            with self._changed:
                if k == self._next:  # nobody has asked for another one meanwhile
                    self._files[k], self._next = file, k + 1
                self._changed.notify_all()

    def _wait(self) -> int | None:
        """Return the next frame to draw, once there is room for it; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._next < self._wanted + self._depth)
            return None if self._ended else self._next

    def _fail(self, error: Exception) -> None:
        with self._changed:
            self._error = error
            self._changed.notify_all()
