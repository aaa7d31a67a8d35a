"""Waiting for what counts: what a driver refuses does not end its wait."""

import time
from collections.abc import Callable

from exumi_recorders.contract import Event, Sample

__all__ = ["first_items"]


def first_items(
    receive: Callable[[float], list[Sample | Event]], timeout_s: float
) -> list[Sample | Event]:
    """Return the first samples and events that come; nothing where the time is over.

    Parameters
    ----------
    receive : callable
        Waits for something for at most so many seconds; returns what is left of it, which is
        nothing where all was refused.
    timeout_s : float
    """
    until_s = time.monotonic() + timeout_s
    left_s = timeout_s
    while True:
        items = receive(max(left_s, 0.0))
        left_s = until_s - time.monotonic()
        if items or left_s <= 0:
            return items
