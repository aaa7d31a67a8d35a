"""Every item has one outcome, whatever becomes of the process that works on it."""

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from exumi_data.engine import Outcome, default_workers, local, map_items
from exumi_data.errors import ExumiError, MetadataError, UsageError


class Awkward(Exception):  # noqa: N818  # what it is called does not matter
    """An exception that another process cannot rebuild from its arguments."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


def square(number: int) -> int:
    return number * number


def troubled(number: int, *, folder: str) -> int:
    """Work on a number, each in its own way; leave a note that it was done."""
    ways: dict[int, Any] = {
        3: lambda: os._exit(7),
        5: lambda: os.kill(os.getpid(), signal.SIGKILL),
        9: lambda: sys.exit(4),
        11: lambda: 1 / 0,
        13: lambda: (_ for _ in ()).throw(Awkward("this", "that")),
        15: lambda: (_ for _ in ()).throw(MetadataError("bad", where="x", problems=("a @ $",))),
        17: threading.Lock,
        19: lambda: (_ for _ in ()).throw(MemoryError("too much")),
    }
    if number in ways:
        value = ways[number]()
        if value is not None:
            return value  # type: ignore[no-any-return]  # a lock: it cannot be sent back
    descriptor = os.open(f"{folder}/{number}", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(descriptor, b"x")
    os.close(descriptor)
    return number * number


def by_item(outcomes: Iterator[Outcome[int, int]]) -> dict[int, Outcome[int, int]]:
    listed = list(outcomes)
    counts = Counter(outcome.item for outcome in listed)
    assert [item for item, count in counts.items() if count > 1] == []
    return {outcome.item: outcome for outcome in listed}


@pytest.mark.parametrize("workers", [1, 2])
def test_every_item_has_one_outcome(workers: int) -> None:
    outcomes = by_item(map_items(square, range(40), workers=workers))
    assert {item: outcome.value for item, outcome in outcomes.items()} == {
        number: number * number for number in range(40)
    }
    assert all(outcome.error is None for outcome in outcomes.values())


@pytest.mark.parametrize("workers", [1, 2])
def test_nothing_to_do(workers: int) -> None:
    assert list(map_items(square, [], workers=workers)) == []


def test_the_default_is_all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    assert 1 <= default_workers() <= (os.cpu_count() or 1)


@pytest.mark.parametrize(("told", "workers"), [("3", 3), ("1", 1)])
def test_the_default_can_be_told(monkeypatch: pytest.MonkeyPatch, told: str, workers: int) -> None:
    monkeypatch.setenv("PYTHON_CPU_COUNT", told)
    assert default_workers() == workers


@pytest.mark.parametrize("told", ["default", "0", "-1", "many", ""])
def test_what_is_no_number_of_workers_tells_nothing(
    monkeypatch: pytest.MonkeyPatch, told: str
) -> None:
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    cores = default_workers()
    monkeypatch.setenv("PYTHON_CPU_COUNT", told)
    assert default_workers() == cores


WARMED = """
import sys
from multiprocessing.forkserver import _forkserver
from exumi_data.engine import warm_up
warm_up("json", workers=int(sys.argv[1]))
print(_forkserver._forkserver_pid is not None)
"""


@pytest.mark.skipif(os.name != "posix", reason="workers are forked on POSIX alone")
@pytest.mark.parametrize(("workers", "warmed"), [(1, False), (2, True)])
def test_nothing_is_warmed_up_where_no_workers_will_be(workers: int, warmed: bool) -> None:
    command = [sys.executable, "-c", WARMED, str(workers)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout == f"{warmed}\n"


WORKING = """
from exumi_data.engine import map_items
if __name__ == "__main__":
    print(sorted(outcome.value for outcome in map_items(abs, [-1, 2, -3], workers=2)))
"""


def test_what_lies_in_the_current_folder_is_not_run(tmp_path: Path) -> None:
    """Somebody's dataset may hold files of any name, also of Python's own modules."""
    program, data = tmp_path / "program.py", tmp_path / "data"
    program.write_text(WORKING)
    data.mkdir()
    for name in ("selectors", "signal", "socket", "struct", "json", "exumi_data"):
        (data / f"{name}.py").write_text("import pathlib; pathlib.Path('RAN').touch()")
    done = subprocess.run(
        [sys.executable, program], cwd=data, check=False, capture_output=True, text=True
    )
    assert (done.stdout, done.returncode) == ("[1, 2, 3]\n", 0), done.stderr
    assert not (data / "RAN").exists()
    assert "PYTHONSAFEPATH" not in os.environ


def test_exceptions_and_deaths_are_outcomes_and_the_others_complete(tmp_path: Path) -> None:
    function = partial(troubled, folder=str(tmp_path))
    outcomes = by_item(map_items(function, range(20), workers=2))
    assert outcomes.keys() == set(range(20))
    died = {number for number, outcome in outcomes.items() if "died" in str(outcome.error)}
    assert died == {3, 5}
    for number in died:
        assert isinstance(outcomes[number].error, ExumiError)
    assert isinstance(outcomes[11].error, ZeroDivisionError)
    assert isinstance(outcomes[19].error, MemoryError)
    refused = outcomes[15].error
    assert isinstance(refused, MetadataError)
    assert refused.problems == ("a @ $",)
    assert "Awkward: this and that" in str(outcomes[13].error)
    assert "status 4" in str(outcomes[9].error)
    assert "lock" in str(outcomes[17].error)
    odd = {3, 5, 9, 11, 13, 15, 17, 19}
    for number in set(range(20)) - odd:
        assert outcomes[number].value == number * number
        assert outcomes[number].error is None
    assert {int(path.name) for path in tmp_path.iterdir()} == set(range(20)) - odd
    assert all(outcomes[number].value is None for number in odd)


def dies(_: int) -> int:
    os._exit(1)


def test_when_every_worker_dies_every_item_is_named() -> None:
    outcomes = by_item(map_items(dies, range(2), workers=2))
    assert outcomes.keys() == {0, 1}
    assert all("died" in str(outcome.error) for outcome in outcomes.values())


def test_exceptions_are_outcomes_in_this_process_too(tmp_path: Path) -> None:
    function = partial(troubled, folder=str(tmp_path))
    outcomes = by_item(map_items(function, [1, 11, 15, 2], workers=1))
    assert isinstance(outcomes[11].error, ZeroDivisionError)
    assert isinstance(outcomes[15].error, MetadataError)
    assert outcomes[2].value == 4


def test_a_function_that_cannot_be_sent_is_an_outcome() -> None:
    outcomes = list(map_items(lambda number: number, range(3), workers=2))
    assert len(outcomes) == 3
    assert all("pickle" in str(outcome.error).lower() for outcome in outcomes)


@pytest.mark.parametrize("workers", [1, 2])
def test_items_are_taken_as_needed(workers: int) -> None:
    taken = 0

    def endless() -> Iterator[int]:
        nonlocal taken
        for number in itertools.count():
            taken = number + 1
            yield number

    outcomes = map_items(square, endless(), workers=workers)
    for _ in range(20):
        next(outcomes)
    assert taken <= 20 + 2 * 4 * workers
    outcomes.close()


def test_an_error_of_the_source_is_the_callers() -> None:
    def broken() -> Iterator[int]:
        yield 1
        raise UsageError("the list ends here")

    for workers in (1, 2):
        with pytest.raises(UsageError, match="the list ends here"):
            list(map_items(square, broken(), workers=workers))


INTERRUPTED = """
import os, pathlib, sys, time
from exumi_data.engine import map_items

def slow(number, folder=sys.argv[1]):
    note = pathlib.Path(folder, f"{number}-{os.getpid()}")
    try:
        note.write_text("x")
        time.sleep(60)
    finally:
        note.unlink(missing_ok=True)

if __name__ == "__main__":
    try:
        for outcome in map_items(slow, range(100), workers=2):
            print(outcome)
    except KeyboardInterrupt:
        print("stopped", flush=True)
        sys.exit(130)
"""


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{process}/stat")
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"


def wait_until(condition: Any, seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("how", ["terminal", "parent only", "stopped"])
def test_ctrl_c_ends_the_workers_and_lets_them_clean_up(tmp_path: Path, how: str) -> None:
    (tmp_path / "program.py").write_text(INTERRUPTED)
    notes = tmp_path / "notes"
    notes.mkdir()
    command = [sys.executable, str(tmp_path / "program.py"), str(notes)]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as parent:
        try:
            wait_until(lambda: len(list(notes.iterdir())) == 2)
            workers = [int(note.name.partition("-")[2]) for note in notes.iterdir()]
            assert all(map(is_running, workers))
            # A terminal sends it to all processes of the group.
            if how == "parent only":
                parent.send_signal(signal.SIGINT)
            elif how == "terminal":
                os.killpg(parent.pid, signal.SIGINT)
            else:  # Ctrl-Z, then an end: any thread of the parent may take it
                os.killpg(parent.pid, signal.SIGSTOP)
                os.killpg(parent.pid, signal.SIGINT)
                os.killpg(parent.pid, signal.SIGCONT)
            out, err = parent.communicate(timeout=30)
        except BaseException:
            os.killpg(parent.pid, signal.SIGKILL)
            raise
    assert (parent.returncode, out) == (130, "stopped\n"), err
    assert err == ""
    assert list(notes.iterdir()) == []  # what was half written is gone, and nothing else was begun
    wait_until(lambda: not any(map(is_running, workers)))


@pytest.mark.parametrize("signals", [1, 2])
def test_a_signal_waits_for_the_end_of_a_block_and_a_second_does_not(signals: int) -> None:
    def run() -> None:
        with local.signals_later():
            for number in range(signals):
                signal.raise_signal(signal.SIGINT)
                done.append(number)

    before = signal.getsignal(signal.SIGINT)
    done: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        run()
    assert done == [0]
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_is_not_lost_where_the_block_fails() -> None:
    def run() -> None:
        with local.signals_later():
            signal.raise_signal(signal.SIGTERM)
            assert seen == []
            raise ValueError("no")

    seen: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    try:
        with pytest.raises(ValueError, match="no"):
            run()
        assert seen == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)


def test_signals_of_other_threads_are_left_alone() -> None:
    def run() -> None:
        with local.signals_later():
            found.append(signal.getsignal(signal.SIGINT))

    found: list[Any] = []
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [signal.getsignal(signal.SIGINT)]
