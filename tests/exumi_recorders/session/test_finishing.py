"""Finishing episodes in the background, with the program itself doing it."""

import os
import time
from pathlib import Path

import pytest

from exumi_data.catalog import list_episodes
from exumi_recorders.journal.states import list_journals
from exumi_recorders.session.finishing import Finished, Finisher
from tests.exumi_recorders.finalise.journals import make_dataset, make_journal, samples
from tests.exumi_recorders.numbered import PORTS

PATIENCE_S = 60.0


def a_journal(folder: Path) -> Path:
    dataset = make_dataset(folder / "set")
    return make_journal(dataset, {"pose": (PORTS["pose"], samples("pose", 30))})


def start_through(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make what finishes an episode start through a script; return the mark that it leaves."""
    mark, nice = folder / "started", folder / "bin" / "nice"
    nice.parent.mkdir()
    nice.write_text(f"#!/bin/sh\ntrap '' TERM\n: > '{mark}'\nshift 2\n{script}\n")
    nice.chmod(0o755)
    monkeypatch.setenv("PATH", f"{nice.parent}:{os.environ['PATH']}")
    return mark


def give_up_after(mark: Path, finisher: Finisher) -> None:
    end = time.monotonic() + PATIENCE_S
    while not mark.exists():
        assert time.monotonic() < end
        time.sleep(0.005)
    finisher.give_up()


def test_what_is_finished_is_told(tmp_path: Path) -> None:
    journal = a_journal(tmp_path)
    told: list[Finished] = []
    finisher = Finisher(told.append)
    finisher.put(journal)
    finisher.close()
    (done,) = told
    assert (done.journal, done.samples, finisher.waiting) == (journal, {"pose": 30}, 0)
    assert done.episode is not None
    assert list_journals(tmp_path / "set") == []


def test_what_is_done_in_the_last_instant_is_told_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Giving up asks the script to end, which does not hear it: as if it had just been done.
    mark = start_through(tmp_path, '"$@"', monkeypatch)
    told: list[Finished] = []
    finisher = Finisher(told.append)
    finisher.put(a_journal(tmp_path))
    give_up_after(mark, finisher)
    (done,) = told
    assert done.episode is not None
    assert [tmp_path / "set" / path for path in list_episodes(tmp_path / "set")] == [done.episode]


def test_what_is_given_up_stays_a_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = start_through(tmp_path, "exit 1", monkeypatch)
    journal = a_journal(tmp_path)
    told: list[Finished] = []
    finisher = Finisher(told.append)
    finisher.put(journal)
    give_up_after(mark, finisher)
    assert [one.episode for one in told if one.episode is not None] == []
    assert list_journals(tmp_path / "set") == [journal]
