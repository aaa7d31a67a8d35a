"""Many spoiled stores in processes that may crash, hang or take too much memory."""

import ctypes
import multiprocessing
import os
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
    from tests.fuzz.judging import judge

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
    shared = Path("/dev/shm")
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


def _outcomes(
    source: Iterator[int], stores: Sequence[Store], seed: int, count: int, folder: Path
) -> Iterator[Outcome]:
    _warm(stores, seed, folder)
    idle: list[_Worker] = []
    busy: dict[Connection, _Worker] = {}
    again: list[int] = []  # what seemed to hang, on a machine that may have been busy
    tried: set[int] = set()
    try:
        while True:
            while len(busy) < count:
                number = again.pop() if again else next(source, None)
                if number is None:
                    break
                worker = idle.pop() if idle else _Worker(stores, seed, folder)
                worker.start(number)
                busy[worker.connection] = worker
            if not busy:
                return
            for ready in wait(list(busy), timeout=0.5):
                worker = busy.pop(ready)  # type: ignore[call-overload]  # only connections are waited for
                try:
                    yield Outcome(**worker.connection.recv())
                except (EOFError, OSError):
                    yield _dead(worker, stores, seed)
                    continue
                if worker.cases < _CASES_PER_PROCESS:
                    idle.append(worker)
                else:
                    worker.end()
            for worker in [w for w in busy.values() if time.monotonic() - w.since > LONGEST_S]:
                del busy[worker.connection]
                worker.process.kill()
                worker.end()
                if worker.number in tried:
                    yield _late(worker, stores, seed)
                else:
                    tried.add(worker.number)
                    again.append(worker.number)
    finally:
        for worker in (*idle, *busy.values()):
            worker.process.kill()
            worker.end()


def _warm(stores: Sequence[Store], seed: int, folder: Path) -> None:
    """Import what is imported late before processes are forked."""
    import av  # noqa: F401
    import cv2
    import pyarrow.parquet  # noqa: F401

    import tests.fuzz.judging

    cv2.setNumThreads(1)
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def _dead(worker: _Worker, stores: Sequence[Store], seed: int) -> Outcome:
    code = worker.end()
    return _lost(worker, stores, seed, f"the process died with code {code}")


def _late(worker: _Worker, stores: Sequence[Store], seed: int) -> Outcome:
    return _lost(worker, stores, seed, f"it took more than {LONGEST_S} s, twice")


def _lost(worker: _Worker, stores: Sequence[Store], seed: int, mistake: str) -> Outcome:
    draft = spoiled(stores, seed, worker.number)
    return Outcome(worker.number, draft.store.name, draft.done, mistakes=[mistake])


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
