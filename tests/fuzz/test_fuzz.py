"""A sample of what `scripts/fuzz_validate.py` does: always the same five hundred spoiled stores."""

import signal
import time
from pathlib import Path

import pytest

from tests.fuzz import running
from tests.fuzz.running import MOST_BYTES, Outcome, run, summary
from tests.fuzz.spoiling import spoiled
from tests.fuzz.stores import Draft, Special, Store, all_stores

SEED = 0
COUNT = 500
LONGEST_S = 5.0  # also where the machine has other things to do

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(),
    reason="this system does not say how much memory a process has",
)


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    with pytest.MonkeyPatch.context() as patched:
        # The processes are forked from this one, which may have run thousands of tests before.
        patched.setattr(running, "MOST_BYTES", MOST_BYTES + resident_bytes())
        return run(range(COUNT), seed=SEED)


def test_nothing_crashes_hangs_or_takes_too_much(outcomes: list[Outcome]) -> None:
    failed = [(o.number, o.store, o.done, o.mistakes) for o in outcomes if o.mistakes]
    assert failed == [], f"python scripts/fuzz_validate.py --seed {SEED} --only {failed[0][0]}"
    assert [o.number for o in outcomes] == list(range(COUNT))
    assert {o.exit_code for o in outcomes} <= {0, 1, 2}
    assert min(o.peak for o in outcomes) > 0


def test_the_sample_is_worth_its_time(outcomes: list[Outcome]) -> None:
    figures = summary(outcomes, SEED)
    assert figures["rules found"] > 50
    assert figures["reads refused"] > 500
    assert figures["exit codes"]["0"] > 10
    # Not every spoiled store is invalid, but most are.
    assert figures["exit codes"]["1"] > COUNT // 2


def test_a_number_is_always_the_same_store() -> None:
    stores = all_stores()
    for number in range(0, COUNT, 7):
        first, second = (spoiled(stores, SEED, number) for _ in range(2))
        assert first.done == second.done
        assert first.files == second.files


def resident_bytes() -> int:
    """What this process has, and what is forked from it with it."""
    (line,) = (
        line
        for line in Path("/proc/self/status").read_text().splitlines()
        if line.startswith("VmRSS")
    )
    return int(line.split()[1]) * 1024


def test_what_fails_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A crash, a hang, an exception and much memory are four kinds of failure."""
    import os

    from tests.fuzz import judging

    def judge(path: Path) -> judging.Verdict:
        number = int((path / "number").read_text())
        if number == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        if number == 2:
            time.sleep(30)
        if number == 3:
            return judging.Verdict(mistakes=["an exception"])
        if number == 4:
            bytearray(b"x") * (400 << 20)
        return judging.Verdict(exit_code=0)

    store = Store("nothing", "store.zarr", {})

    def numbered(stores: object, seed: int, number: int) -> Draft:
        return Draft(store, {"number": str(number).encode(), "x": Special.PIPE})

    monkeypatch.setattr(judging, "judge", judge)
    monkeypatch.setattr(running, "spoiled", numbered)
    monkeypatch.setattr(running, "all_stores", list)
    monkeypatch.setattr(running, "LONGEST_S", LONGEST_S)
    monkeypatch.setattr(running, "MOST_BYTES", resident_bytes() + (100 << 20))
    found = {outcome.number: outcome.mistakes for outcome in run(range(6), seed=0)}
    assert found[0] == found[5] == []
    assert found[1] == ["the process died with code -9"]
    assert found[2] == [f"it took more than {LONGEST_S} s, twice"]
    assert found[3] == ["an exception"]
    assert "bytes of memory" in found[4][0]
