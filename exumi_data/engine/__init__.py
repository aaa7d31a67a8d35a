"""Map a function over episodes: here with processes, or on a cluster, with the same outcomes."""

from collections.abc import Callable, Generator, Iterable
from typing import TypeVar

from exumi_data.engine.local import default_workers, map_locally, warm_up
from exumi_data.engine.outcome import Engine, Outcome

__all__ = ["Engine", "Outcome", "default_workers", "map_items", "warm_up"]

Item = TypeVar("Item")
Value = TypeVar("Value")


def map_items(
    function: Callable[[Item], Value],
    items: Iterable[Item],
    *,
    workers: int | None = None,
    engine: Engine | None = None,
) -> Generator[Outcome[Item, Value], None, None]:
    """Call `function` on every item; yield outcomes as they come, in any order.

    Parameters
    ----------
    function : callable
        A module-level function (or partial of one): it is sent to other processes.
    items : iterable
        Taken as needed: at most a few per worker are under way.
    workers : int, optional
        Processes; default all cores; 1 runs in this process. With `engine`, how many items are
        worked on at a time; default as many as it has processors.
    engine : Engine, optional
        Where the processes are, such as `exumi_data.engine.ray_engine.ray_engine`; default this
        machine.

    Yields
    ------
    Outcome
        An exception of `function` is an outcome, never a stop. A worker that dies (out of memory,
        a crash in a codec) is an outcome of the item that killed it; the others are done again.
    """
    if engine is None:
        return map_locally(function, items, workers)
    return engine.map_items(function, items, workers=workers)
