"""Properties that are worked out once, without the lock that Python 3.11 holds meanwhile."""

from contextlib import nullcontext
from functools import cached_property
from typing import TypeVar

__all__ = ["unlocked"]

C = TypeVar("C", bound=type)


def unlocked(decorated: C) -> C:
    """Let the cached properties of a class be read by many threads at a time, and after a fork.

    Before Python 3.12 a cached property has one lock for all objects of its class. Threads that
    read from a server would wait for each other, and a process that is forked while one of them
    waits would find the lock taken for ever. Without it a value may be worked out twice.

    Parameters
    ----------
    decorated : type
        As a decorator of it.
    """
    for value in vars(decorated).values():
        if isinstance(value, cached_property) and hasattr(value, "lock"):
            value.lock = nullcontext()
    return decorated
