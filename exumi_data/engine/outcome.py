"""What became of an item, and what runs a map in another way than processes of this machine."""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

__all__ = ["Engine", "Outcome"]

Item = TypeVar("Item")
Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class Outcome(Generic[Item, Value]):
    """What became of one item: `value`, or `error`."""

    item: Item
    value: Value | None
    error: Exception | None


class Engine(Protocol):
    """Runs a map elsewhere, such as on a cluster; see `exumi_data.engine.ray_engine`."""

    def map_items(
        self, function: Callable[[Item], Value], items: Iterable[Item], *, workers: int | None
    ) -> Generator[Outcome[Item, Value], None, None]:
        """Do what `exumi_data.engine.map_items` does, with the same outcomes.

        Parameters
        ----------
        function : callable
        items : iterable
        workers : int, optional
            At most so many items at a time; default as many as the engine has processors for.

        Yields
        ------
        Outcome
        """
        ...
