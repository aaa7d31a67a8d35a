"""Map a function over episodes on a Ray cluster: bounded queues, retries, Ctrl-C clean.

Ray carries the items to its workers and the outcomes back. Episodes themselves are read and written
by the workers: the nodes must see the same files under the same paths.
"""

import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from exumi_data.engine.outcome import Outcome
from exumi_data.engine.ray_cluster import cluster, ray_module
from exumi_data.engine.ray_nodes import check_nodes, node_name, problems_of, working_nodes
from exumi_data.engine.ray_worker import run_item
from exumi_data.engine.work import CLEAN_UP_S
from exumi_data.errors import ExumiError

__all__ = ["RayEngine", "ray_engine"]

Item = TypeVar("Item")
Value = TypeVar("Value")

_QUEUED_PER_WORKER = 4
_ATTEMPTS = 3
_NODE = "ray.io/node-id"  # a label that every node has
_LOOK_AGAIN_S = 5.0  # nodes may join while we work


@contextmanager
def ray_engine(
    address: str | None = None,
    *,
    workers: int | None = None,
    reads: Sequence[Path] = (),
    writes: Sequence[Path] = (),
) -> "Iterator[RayEngine]":
    """Work on a Ray cluster while the block runs.

    A program that has joined a cluster (``ray.init``) works on that one.

    Parameters
    ----------
    address : str, optional
        Of the head, ``host:port``. Default: what RAY_ADDRESS says, else the cluster that runs on
        this machine; if there is none, one is started on this machine, and ended with the block.
    workers : int, optional
        Processors of a cluster that is started; default all cores.
    reads, writes : sequence of pathlib.Path
        What will be read, and what will be made: every node must see it.

    Yields
    ------
    RayEngine

    Raises
    ------
    MissingExtraError
        Ray is not installed.
    UsageError
        The cluster cannot be joined, or a node lacks the files or this version of the library.

    Examples
    --------
    >>> with ray_engine("10.0.0.1:6379") as engine:  # doctest: +SKIP
    ...     report = validate("/shared/my-dataset", engine=engine)
    """
    with cluster(address, workers) as own:
        check_nodes(reads, writes)
        nodes = working_nodes()
        processors = int(sum(node["Resources"]["CPU"] for node in nodes))
        late = _Latecomers(reads, writes, {node["NodeID"] for node in nodes})
        yield RayEngine(len(nodes), processors, own=own, _late=late)


class _Latecomers:
    """Nodes that joined after the others were asked; those that cannot take part get nothing."""

    def __init__(self, reads: Sequence[Path], writes: Sequence[Path], known: set[str]) -> None:
        self._reads = reads
        self._writes = writes
        self._known = known
        self.refused: list[str] = []

    def look(self) -> int:
        """Ask the nodes that are new; return how many processors there are for us."""
        nodes = working_nodes()
        new = [node for node in nodes if node["NodeID"] not in self._known]
        self._known |= {node["NodeID"] for node in new}
        found = problems_of(new, self._reads, self._writes) if new else {}
        for node in new:
            if problems := found[node_name(node)]:
                self.refused.append(node["NodeID"])
                warnings.warn(
                    f"a node that joined the Ray cluster is given no more work, for it cannot do "
                    f"this: {node_name(node)}: {'; '.join(problems)}",
                    stacklevel=2,
                )
        ours = [node for node in nodes if node["NodeID"] not in self.refused]
        return int(sum(node["Resources"]["CPU"] for node in ours))


@dataclass(frozen=True, slots=True)
class RayEngine:
    """The Ray cluster that this process is part of; made by `ray_engine`.

    Attributes
    ----------
    nodes, processors : int
        When it was joined.
    own : bool
        Whether it was started for this run, on this machine.
    """

    nodes: int
    processors: int
    own: bool
    _late: _Latecomers = field(repr=False)

    def map_items(
        self, function: Callable[[Item], Value], items: Iterable[Item], *, workers: int | None
    ) -> Generator[Outcome[Item, Value], None, None]:
        """Do what `exumi_data.engine.map_items` does, on the cluster.

        An item whose worker or node dies is tried again, three times in all.

        Parameters
        ----------
        function : callable
        items : iterable
        workers : int, optional
            At most so many items at a time; default as many as the cluster has processors, also
            those of nodes that join later.

        Yields
        ------
        Outcome
        """
        return _Map(function, workers, self._late).run(items)


@dataclass(slots=True)
class _Attempt(Generic[Item]):
    item: Item
    died: int = 0


class _Map(Generic[Item, Value]):
    """One map: what is under way, and what has to be tried again."""

    def __init__(
        self, function: Callable[[Item], Value], workers: int | None, late: _Latecomers
    ) -> None:
        self._ray = ray_module()
        # Ray's own retries go on for ever where memory runs out. By its own choice of nodes the
        # one that the program runs on gets what comes, and others stand idle for seconds.
        self._task = self._ray.remote(num_cpus=1, max_retries=0, scheduling_strategy="SPREAD")(
            _task_of(function, str(Path.cwd()))
        )
        self._workers = workers
        self._late = late
        self._pending: dict[Any, _Attempt[Item]] = {}
        self._again: deque[_Attempt[Item]] = deque()
        self._room = 0
        self._looked_s = -_LOOK_AGAIN_S

    def run(self, items: Iterable[Item]) -> Generator[Outcome[Item, Value], None, None]:
        source = map(_Attempt, items)
        exhausted = False
        try:
            while True:
                while len(self._pending) < self._room_now():
                    attempt = self._again.popleft() if self._again else None
                    if attempt is None and not exhausted:
                        attempt = next(source, None)
                        exhausted = attempt is None
                    if attempt is None:
                        break
                    refused = self._submit(attempt)
                    if refused is not None:
                        yield refused
                if not self._pending:
                    return
                for reference in self._ready():
                    outcome = self._outcome(reference)
                    if outcome is not None:
                        yield outcome
        except BaseException:
            self._cancel()
            raise

    def _room_now(self) -> int:
        """Return how many items may be under way: where all processors are ours, some wait."""
        now = time.monotonic()
        if now - self._looked_s >= _LOOK_AGAIN_S:
            self._looked_s = now
            processors = self._late.look()
            self._room = _QUEUED_PER_WORKER * max(processors, 1)
            if self._workers is not None and self._workers < processors:
                self._room = self._workers
        return self._room

    def _submit(self, attempt: _Attempt[Item]) -> Outcome[Item, Value] | None:
        try:
            task = self._task
            if refused := self._late.refused:
                task = task.options(label_selector={_NODE: f"!in({','.join(refused)})"})
            reference = task.remote(attempt.item)
        except Exception as error:  # noqa: BLE001  # whatever the pickling of a third party's object raises
            # The function or the item cannot be sent between processes.
            return Outcome(attempt.item, None, _unsendable(error))
        self._pending[reference] = attempt
        return None

    def _ready(self) -> list[Any]:
        waiting = list(self._pending)
        ready, _ = self._ray.wait(waiting, num_returns=1, timeout=_LOOK_AGAIN_S)
        if len(ready) == 1:
            ready, _ = self._ray.wait(waiting, num_returns=len(waiting), timeout=0)
        return list(ready)

    def _outcome(self, reference: Any) -> Outcome[Item, Value] | None:
        """Return what became of an item; None if it is to be tried again."""
        attempt = self._pending.pop(reference)
        try:
            value, error = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as failure:
            # Its value cannot be sent between processes.
            return Outcome(attempt.item, None, _unsendable(failure.cause or failure))
        except self._ray.exceptions.RayError as failure:
            attempt.died += 1
            if attempt.died == _ATTEMPTS:
                return Outcome(attempt.item, None, _crash(failure))
            self._again.append(attempt)
            return None
        return Outcome(attempt.item, value, error)

    def _cancel(self) -> None:
        """End what is under way; what is half written is removed."""
        for reference in self._pending:
            self._ray.cancel(reference)  # raises KeyboardInterrupt in the worker
        left = self._unfinished(list(self._pending))
        for reference in left:
            self._ray.cancel(reference, force=True)  # it did not listen
        self._unfinished(left)

    def _unfinished(self, references: list[Any]) -> list[Any]:
        """Wait for a moment; return those that are not done."""
        if not references:
            return []
        _, left = self._ray.wait(references, num_returns=len(references), timeout=CLEAN_UP_S)
        return list(left)


def _task_of(
    function: Callable[[Item], Value], folder: str
) -> Callable[[Item], tuple[Value | None, Exception | None]]:
    def task(item: Item) -> tuple[Value | None, Exception | None]:
        """Run an item; the function is sent to a worker with this one, and once only."""
        return run_item(function, item, folder)

    return task


def _unsendable(error: BaseException) -> ExumiError:
    return ExumiError(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}")


def _crash(failure: Exception) -> ExumiError:
    return ExumiError(
        f"the worker process died while it was working on this (a crash in a codec, or out of "
        f"memory), {_ATTEMPTS} times; the last time: {str(failure).partition(chr(10))[0]}",
        fix="Try again on this machine alone (--engine local --workers 1) to see where.",
    )
