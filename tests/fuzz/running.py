"""Many spoiled stores in processes that may crash, hang or take too much memory."""

import ctypes
import multiprocessing
import resource
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any

from tests.fuzz.spoiling import spoiled
from tests.fuzz.stores import Store, all_stores

__all__ = ["LONGEST_S", "MOST_BYTES", "Outcome", "run", "summary"]

LONGEST_S = 10.0
MOST_BYTES = 1 << 30
_ADDRESS_SPACE = 8 << 30
_CASES_PER_PROCESS = 400


@dataclass
class Outcome:
    """What became of one number."""

    number: int
    store: str = ""
    done: list[str] = field(default_factory=list)
    exit_code: int | None = None
    codes: list[str] = field(default_factory=list)
    message: str = ""
    refused: int = 0
    seconds: float = 0.0
    peak: int = 0
    mistakes: list[str] = field(default_factory=list)


class _Worker:
    """A process that judges one number after the other."""

    def __init__(self, stores: Sequence[Store], seed: int, folder: Path) -> None:
        context = multiprocessing.get_context("fork")
        self.connection, other = context.Pipe()
        arguments = (other, stores, seed, folder)
        self.process: ForkProcess = context.Process(target=_serve, args=arguments, daemon=True)
        self.process.start()
        other.close()
        self.number = -1
        self.since = 0.0
        self.cases = 0

    def start(self, number: int) -> None:
        self.number, self.since = number, time.monotonic()
        self.cases += 1
        self.connection.send(number)

    def end(self) -> int | None:
        self.connection.close()
        self.process.join(1)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        return self.process.exitcode


def _serve(connection: Connection, stores: Sequence[Store], seed: int, folder: Path) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    while True:
        try:
            number = connection.recv()
        except EOFError:
            return
        connection.send(asdict(_judged(stores, seed, number, folder)))


def _judged(stores: Sequence[Store], seed: int, number: int, folder: Path) -> Outcome:
    from tests.fuzz.judging import judge  # the processes inherit it

    draft = spoiled(stores, seed, number)
    outcome = Outcome(number, draft.store.name, draft.done)
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as empty:
        target = draft.write(Path(empty))
        _forget_peak()
        started = time.perf_counter()
        verdict = judge(target)
        outcome.seconds = time.perf_counter() - started
    outcome.peak = _peak()
    for name in ("exit_code", "codes", "message", "refused", "mistakes"):
        setattr(outcome, name, getattr(verdict, name))
    if outcome.peak > MOST_BYTES:
        outcome.mistakes.append(f"{outcome.peak:,} bytes of memory")
        # What the allocator keeps would count against the next one.
        ctypes.CDLL(None).malloc_trim(0)
    return outcome


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def _peak() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return 0


def run(
    numbers: Iterable[int],
    *,
    seed: int,
    workers: int = 2,
    on_done: Callable[[Outcome], object] | None = None,
) -> list[Outcome]:
    """Judge the stores of some numbers.

    Parameters
    ----------
    numbers : iterable of int
    seed : int
    workers : int
        Processes.
    on_done : callable, optional
        Told of each outcome.

    Returns
    -------
    list of Outcome
        In the order of the numbers.
    """
    stores = all_stores()
    shared = Path("/dev/shm")  # noqa: S108  # memory: twenty thousand stores need no disk
    folder = Path(tempfile.mkdtemp(prefix="exumi-fuzz-", dir=shared if shared.is_dir() else None))
    try:
        found = []
        for outcome in _outcomes(iter(numbers), stores, seed, workers, folder):
            found.append(outcome)
            if on_done is not None:
                on_done(outcome)
        return sorted(found, key=lambda outcome: outcome.number)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class _Crew:
    """The processes of a run: those that wait, and those that work."""

    def __init__(self, stores: Sequence[Store], seed: int, folder: Path) -> None:
        self.stores, self.seed, self.folder = stores, seed, folder
        self.idle: list[_Worker] = []
        self.busy: dict[Connection, _Worker] = {}
        self.again: list[int] = []  # what seemed to hang, on a machine that may have been busy
        self.tried: set[int] = set()

    def start(self, number: int) -> None:
        worker = self.idle.pop() if self.idle else _Worker(self.stores, self.seed, self.folder)
        worker.start(number)
        self.busy[worker.connection] = worker

    def finished(self) -> Iterator[Outcome]:
        for ready in wait(list(self.busy), timeout=0.5):
            worker = self.busy.pop(ready)  # type: ignore[call-overload]  # only connections are waited for
            try:
                outcome = Outcome(**worker.connection.recv())
            except (EOFError, OSError):
                yield self._lost(worker, f"the process died with code {worker.end()}")
                continue
            if worker.cases < _CASES_PER_PROCESS:
                self.idle.append(worker)
            else:
                worker.end()
            yield outcome

    def late(self) -> Iterator[Outcome]:
        now = time.monotonic()
        for worker in [one for one in self.busy.values() if now - one.since > LONGEST_S]:
            del self.busy[worker.connection]
            worker.process.kill()
            worker.end()
            if worker.number in self.tried:
                yield self._lost(worker, f"it took more than {LONGEST_S} s, twice")
            else:
                self.tried.add(worker.number)
                self.again.append(worker.number)

    def _lost(self, worker: _Worker, mistake: str) -> Outcome:
        draft = spoiled(self.stores, self.seed, worker.number)
        return Outcome(worker.number, draft.store.name, draft.done, mistakes=[mistake])

    def end(self) -> None:
        for worker in (*self.idle, *self.busy.values()):
            worker.process.kill()
            worker.end()


def _outcomes(
    source: Iterator[int], stores: Sequence[Store], seed: int, count: int, folder: Path
) -> Iterator[Outcome]:
    _warm()
    crew = _Crew(stores, seed, folder)
    try:
        while True:
            while len(crew.busy) < count:
                number = crew.again.pop() if crew.again else next(source, None)
                if number is None:
                    break
                crew.start(number)
            if not crew.busy:
                return
            yield from crew.finished()
            yield from crew.late()
    finally:
        crew.end()


def _warm() -> None:
    """Import what is imported late before processes are forked."""
    import av  # noqa: F401
    import cv2
    import pyarrow.parquet  # noqa: F401

    import tests.fuzz.judging  # noqa: F401

    cv2.setNumThreads(1)


def summary(outcomes: Sequence[Outcome], seed: int) -> dict[str, Any]:
    """Return the figures of a run."""
    codes = Counter(code for outcome in outcomes for code in outcome.codes)
    slowest = max(outcomes, key=lambda outcome: outcome.seconds)
    largest = max(outcomes, key=lambda outcome: outcome.peak)
    failed = [outcome for outcome in outcomes if outcome.mistakes]
    return {
        "seed": seed,
        "stores": len(outcomes),
        "exit codes": dict(Counter(str(outcome.exit_code) for outcome in outcomes)),
        "rules found": len(codes),
        "reads refused": sum(outcome.refused for outcome in outcomes),
        "slowest": {"number": slowest.number, "seconds": round(slowest.seconds, 2)},
        "largest": {"number": largest.number, "bytes": largest.peak},
        "failed": [asdict(outcome) for outcome in failed],
    }
