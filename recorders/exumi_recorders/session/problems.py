"""A problem is told once, when it begins; and that it is over, when it was for a while."""

import re
import time
from collections.abc import Callable, Sequence

from exumi_recorders.recording.status import Problem
from exumi_recorders.session.messages import Message

__all__ = ["ProblemTeller"]

_CALM_S = 2.0
_NUMBER = re.compile(r"\d+(\.\d+)?")


class ProblemTeller:
    """Tells of problems that begin and end.

    Parameters
    ----------
    tell : callable
        Told of each message.
    """

    def __init__(self, tell: Callable[[Message], None]) -> None:
        self._tell = tell
        self._open: dict[tuple[str, str, str], float] = {}

    def tell(self, problems: Sequence[Problem]) -> int:
        """Tell what is new and what is over; return how many are new.

        Parameters
        ----------
        problems : sequence of Problem
            All there are now.
        """
        now = time.monotonic()
        new = 0
        # A device may have several; of one, the numbers in its text change.
        texts = {(one.where, one.code, _NUMBER.sub("#", one.text)): one.text for one in problems}
        for key, text in texts.items():
            if key not in self._open:
                new += 1
                self._tell(Message("warning", key[1], f"{key[0]}: {text}" if key[0] else text))
            self._open[key] = now
        for key, seen in list(self._open.items()):
            # One that comes and goes is not told each time.
            if now - seen > _CALM_S:
                del self._open[key]
                others = any(where == key[0] for where, _, _ in self._open)
                text = f"{key[0] or 'recorder'}: {'that is over' if others else 'well again'}"
                self._tell(Message("info", f"{key[1]}_over", text))
        return new
