"""What was discarded long enough ago is removed, and nothing else."""

import json
import os
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from exumi_data.cli.app import app
from exumi_data.errors import UsageError
from exumi_recorders.finalise.purging import purge_discarded
from exumi_recorders.finalise.recover import recover
from exumi_recorders.journal.states import (
    STATE_NAME,
    discard,
    locked,
    read_state,
    undo_discard,
    write_state,
)
from tests.exumi_recorders.finalise.journals import make_dataset, make_journal, samples
from tests.exumi_recorders.numbered import POSE, episode

DAY_S = 86_400


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "set")


def journal(dataset: Path, number: int, *, state: str = "stopped") -> Path:
    streams = {"pose": (POSE, samples("pose", 5 * number))}
    return make_journal(dataset, streams, metadata=episode(number), state=state)


def discarded(dataset: Path, number: int, *, days: float) -> Path:
    path = journal(dataset, number)
    discard(path, f"reason {number}")
    then = time.time() - days * DAY_S
    os.utime(path / STATE_NAME, (then, then))
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def size_of(path: Path) -> int:
    return sum(p.stat().st_size for p in path.glob("*/**/*") if p.is_file())


def test_only_what_was_discarded_long_enough_ago_goes(dataset: Path) -> None:
    old, young = discarded(dataset, 1, days=7.1), discarded(dataset, 2, days=6.9)
    others = [journal(dataset, 3), journal(dataset, 4, state="recording")]
    (others[1] / STATE_NAME).write_bytes(b"{")  # as a power loss may leave it
    for other in others:
        os.utime(other / STATE_NAME, (0, 0))
    size, header = size_of(old), (old / "header.json").read_bytes()
    before = contents(dataset)
    dry = purge_discarded([dataset], dry_run=True)
    assert [(one.journal, one.outcome) for one in dry.done] == [(old, "found"), (young, "kept")]
    assert dry.freed == 0
    assert contents(dataset) == before
    result = purge_discarded([dataset])
    assert [(one.journal, one.outcome) for one in result.done] == [(old, "purged"), (young, "kept")]
    assert result.freed == result.done[0].bytes == size > 0
    assert result.failed == ()
    after = contents(dataset)
    gone = {name for name in before if name not in after}
    assert gone
    assert all(name.startswith(f".recording/{old.name}/") for name in gone)
    changed = {name for name in after if after[name] != before[name]}
    assert changed == {f".recording/{old.name}/{STATE_NAME}"}
    # The tombstone stays, and says why.
    assert (old / "header.json").read_bytes() == header
    assert read_state(old).reason == "reason 1"
    with pytest.raises(UsageError, match="logs are gone"):
        undo_discard(old)
    undo_discard(young)
    outcomes = {one.journal: one.outcome for one in recover([dataset]).done}
    assert outcomes == {old: "discarded", young: "finalised", **dict.fromkeys(others, "finalised")}
    assert [one.journal for one in purge_discarded([dataset], older_than_days=0).done] == []


def test_a_purge_that_was_interrupted_is_ended(dataset: Path) -> None:
    path = discarded(dataset, 1, days=0)
    write_state(path, read_state(path).model_copy(update={"purged": True}))
    assert [one.outcome for one in purge_discarded([path]).done] == ["purged"]
    assert sorted(entry.name for entry in path.iterdir()) == ["header.json", STATE_NAME]


def test_one_that_is_held_stays_and_does_not_keep_the_others(dataset: Path) -> None:
    held, other = discarded(dataset, 1, days=9), discarded(dataset, 2, days=9)
    before = contents(held)
    with locked(held):
        result = purge_discarded([dataset])
    assert contents(held) == before
    assert [one.journal for one in result.done] == [other]
    ((path, reason),) = result.failed
    assert path == held
    assert "being recorded or finalised" in reason


def test_links_out_of_a_journal_are_not_followed(dataset: Path, tmp_path: Path) -> None:
    path = discarded(dataset, 1, days=9)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_bytes(b"x" * 1000)
    (path / "link").symlink_to(tmp_path / "mine")
    (path / "pose" / "link").symlink_to(tmp_path / "mine")
    purge_discarded([dataset])
    assert (tmp_path / "mine" / "file").stat().st_size == 1000
    assert not (path / "pose").exists()


def test_a_clock_that_was_set_back_keeps_it(dataset: Path) -> None:
    discarded(dataset, 1, days=-400)
    assert [one.outcome for one in purge_discarded([dataset], older_than_days=0).done] == ["kept"]


# -------------------------------------------------------------------------------- the command line


def test_the_command_says_how_much_it_freed(dataset: Path) -> None:
    old, young = discarded(dataset, 1, days=40), discarded(dataset, 2, days=1)
    size = size_of(old)
    command = ["recover", str(dataset), "--purge-discarded"]
    dry = CliRunner().invoke(app, [*command, "--dry-run"])
    assert f"{old}: would be purged, {size:,} bytes, discarded 40.0 days ago" in dry.stdout
    assert dry.stdout.endswith(f"{size:,} bytes would be freed\n")
    kept = CliRunner().invoke(app, [*command, "--older-than", "50"])
    assert kept.stdout.endswith("\n0 bytes freed\n")
    done = CliRunner().invoke(app, [*command, "--format", "json"])
    assert done.exit_code == 0
    found = json.loads(done.stdout)
    assert [one["outcome"] for one in found["journals"]] == ["purged", "kept"]
    assert found["journals"][0]["reason"] == "reason 1"
    assert (found["freed_bytes"], found["failed"]) == (size, [])
    all_of_it = CliRunner().invoke(app, [*command, "--older-than", "0"])
    assert f"{young}: purged, " in all_of_it.stdout


def test_days_are_of_a_purge_alone(dataset: Path) -> None:
    path = journal(dataset, 1)
    result = CliRunner().invoke(app, ["recover", str(dataset), "--older-than", "1"])
    assert result.exit_code == 2
    assert "--purge-discarded" in result.stderr
    assert path.exists()
