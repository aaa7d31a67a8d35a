"""After a kill, a power loss, a full disk: every journal becomes a valid episode."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import exumi_data
from exumi_data.catalog import episode_path, read_catalog
from exumi_data.cli.app import app
from exumi_data.episode import open_episode
from exumi_data.errors import UsageError
from exumi_recorders.contract import Event
from exumi_recorders.finalise.episode import finalise, inspect
from exumi_recorders.finalise.recover import find_journals, recover
from exumi_recorders.journal.log import segment_name
from exumi_recorders.journal.record import HEADER_BYTES
from exumi_recorders.journal.states import discard, journal_folder, read_state, undo_discard
from exumi_validators import validate
from tests.exumi_recorders.finalise.journals import make_dataset, make_journal, samples
from tests.exumi_recorders.numbered import (
    CAMERA,
    PAYLOADS,
    PORTS,
    POSE,
    counter,
    episode,
    number_of,
)

PROGRAM = "tests.exumi_recorders.recording_process"


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "set")


@contextmanager
def recording(dataset: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A program that records, from the moment on at which it says so."""
    command = [sys.executable, "-m", PROGRAM, str(dataset), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "recording\n"
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def spoil_header(journal: Path) -> None:
    (journal / "header.json").write_text("{")
    shutil.rmtree(journal / "header")


def check_episode(dataset: Path) -> dict[str, int]:
    """Every sample is the one that was sent, without holes; return the last host times."""
    path = dataset / episode_path(episode().id)
    assert [one for one in validate(path).problems if one.severity == "error"] == []
    with open_episode(path) as found:
        assert sorted(found.streams) == ["camera", "counter", "pose"]
        last = {}
        for name, stream in found.streams.items():
            numbers = stream.sequence
            assert numbers is not None
            assert numbers.tolist() == list(range(numbers[0], numbers[0] + len(numbers)))
            assert stream.metadata.gaps is None
            assert stream.time_host is not None
            last[name] = int(stream.time_host[-1])
        camera, pose, taxels = (found[name] for name in ("camera", "pose", "counter"))
        files = [number_of(camera.encoded(k)) for k in range(len(camera))]
        assert files == camera.sequence.tolist()  # type: ignore[union-attr]
        assert pose.data[:, 0].tolist() == pose.sequence.tolist()  # type: ignore[union-attr]
        sent = [counter(int(number)) for number in taxels.sequence]  # type: ignore[union-attr]
        assert [row.tobytes() for row in taxels.data] == sent
        return last


def test_a_kill_costs_next_to_nothing(dataset: Path) -> None:
    with recording(dataset) as process:
        time.sleep(0.7)
        left = recover([dataset])
        assert [one.outcome for one in left.done] == ["recording"]
        assert process.poll() is None
        process.send_signal(signal.SIGKILL)
        killed_ns = time.monotonic_ns()
        process.wait()
    result = recover([dataset])
    assert [(one.outcome, one.crashed) for one in result.done] == [("finalised", True)]
    assert (result.failed, result.notices) == ((), ())
    for name, last_ns in check_episode(dataset).items():
        # 50 ms are promised on a machine that does nothing else: see benchmarks/crash_safety.py.
        assert killed_ns - last_ns < 1_000_000_000, name
    before = contents(dataset)
    again = recover([dataset])
    assert (again.done, again.failed) == ((), ())
    assert contents(dataset) == before
    assert len(exumi_data.open(dataset)) == 1  # type: ignore[arg-type]


def test_a_power_loss_costs_what_was_not_flushed(dataset: Path, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    with recording(dataset, str(trace)):
        time.sleep(1.3)
    safe: dict[str, int] = {}
    for line in trace.read_text().splitlines():
        _, length, path = line.split(" ", 2)
        safe[path] = int(length)
    assert safe
    cut = 0
    for log in journal_folder(dataset, episode().id).rglob("*.log"):
        kept = safe.get(str(log), 0)
        cut += log.stat().st_size - kept
        os.truncate(log, kept)
    assert cut > 0
    result = recover([dataset])
    assert [one.damages for one in result.done] == [()]
    check_episode(dataset)


def test_a_small_disk_runs_full(tmp_path: Path) -> None:
    root = tmp_path / "disk"
    root.mkdir()
    program = f"import {PROGRAM} as p, sys; sys.argv = ['', 'disk/set']; p.main()"
    script = (
        f"mount -t tmpfs -o size=500k none disk && {sys.executable} -c "
        '"from tests.exumi_recorders.finalise.journals import make_dataset; '
        "from pathlib import Path; make_dataset(Path('disk/set'))\" && "
        f'{sys.executable} -c "{program}" && du -k disk/set >&2; cp -a disk/set kept'
    )
    environment = {**os.environ, "PYTHONPATH": f"{Path.cwd()}:{os.environ.get('PYTHONPATH', '')}"}
    command = ["unshare", "-rm", "sh", "-c", script]
    try:
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        pytest.skip("unshare is not installed")
    if not (tmp_path / "kept").is_dir():
        pytest.skip(f"no file system can be mounted here: {done.stderr[-200:]}")
    assert done.stdout.split() == ["recording", "disk_full"]
    result = recover([tmp_path / "kept"])
    assert [one.truncated for one in result.done] == ["disk_full"]
    assert [one.damages for one in result.done] == [()]
    path = tmp_path / "kept" / episode_path(episode().id)
    assert [one for one in validate(path).problems if one.severity == "error"] == []
    with open_episode(path) as found:
        assert {note.code for note in found.metadata.quality} == {"truncated"}
        assert len(found["camera"]) > 10


def test_what_was_being_finalised_is_finalised_again(dataset: Path) -> None:
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 30, 90.0))})
    partial = dataset / "episodes" / "01" / f".partial-{episode().id}"
    (partial / "streams" / "pose").mkdir(parents=True)
    (partial / "zarr.json").write_text("half-written")
    assert recover([journal]).done[0].outcome == "finalised"
    assert not partial.exists()


def test_a_journal_whose_removal_was_interrupted_is_removed(dataset: Path) -> None:
    streams = {"pose": (POSE, samples("pose", 5, 90.0))}
    journal = make_journal(dataset, streams)
    kept = dataset.parent / journal.name
    shutil.copytree(journal, kept)
    recover([dataset])
    (kept / "header.json").unlink()
    (kept / "state.json").unlink()
    shutil.move(kept, journal)
    assert [one.outcome for one in recover([dataset]).done] == ["present"]
    assert not journal.exists()


def test_half_a_journal_is_never_taken_for_one(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The power goes while the journal is removed, and then the episode is moved away."""
    streams = {"pose": (POSE, samples("pose", 5, 90.0)), "camera": (CAMERA, samples("camera", 5))}
    journal = make_journal(dataset, streams)
    real = shutil.rmtree

    def interrupted(path: Path, ignore_errors: bool) -> None:
        if path.exists():
            real(path / "camera")
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("exumi_recorders.finalise.episode.shutil.rmtree", interrupted)
        with pytest.raises(KeyboardInterrupt):
            recover([journal])
    shutil.move(dataset / episode_path(episode().id), dataset.parent / "moved.zarr")
    assert recover([dataset]).done == ()
    assert list((dataset / ".recording").iterdir()) == []
    assert not (dataset / episode_path(episode().id)).exists()


def test_a_journal_that_another_one_finalised_meanwhile(dataset: Path) -> None:
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 5, 90.0))})
    recover([journal])
    again = finalise(journal)
    assert (again.outcome, again.episode) == ("present", dataset / episode_path(episode().id))


def test_one_bad_journal_does_not_keep_the_others(dataset: Path) -> None:
    streams = {"pose": (POSE, samples("pose", 5, 90.0))}
    first, second, third = (
        make_journal(dataset, streams, metadata=episode(number)) for number in (1, 2, 3)
    )
    spoil_header(second)
    before = contents(second)
    result = recover([dataset])
    assert [one.journal for one in result.done] == [first, third]
    assert [path for path, _ in result.failed] == [second]
    assert "not valid JSON" in result.failed[0][1]
    assert contents(second) == before


@pytest.mark.parametrize("content", [None, b"", b"{", b'{"a": "\xff"}', b"other"])
def test_a_damaged_header_is_taken_from_its_copy(dataset: Path, content: bytes | None) -> None:
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 5, 90.0))})
    path = journal / "header.json"
    if content is None:
        path.unlink()
    else:
        # The last one is a document that can be read, and says something else.
        other = path.read_bytes().replace(b'"toy"', b'"tay"')
        path.write_bytes(other if content == b"other" else content)
    (one,) = recover([dataset]).done
    assert (one.outcome, one.samples) == ("finalised", {"pose": 5})
    assert [damage.path for damage in one.damages] == [path]
    with open_episode(dataset / episode_path(episode().id)) as found:
        assert found.metadata.task.name == "toy"
        (note,) = found.metadata.quality
        assert note.code == "journal-damaged"
        assert "header.json at 0" in note.message


@pytest.mark.parametrize("log", ["header", "events", "clock"])
def test_damage_beside_the_samples_costs_none_of_them(dataset: Path, log: str) -> None:
    journal = make_journal(
        dataset, {"pose": (POSE, samples("pose", 5, 90.0))}, events=[Event("key", 1)]
    )
    path = journal / log / segment_name(0)
    path.write_bytes(path.read_bytes()[:-3])
    (one,) = recover([dataset]).done
    assert one.samples == {"pose": 5}
    # The header itself is whole: its copy is not needed.
    assert [damage.path for damage in one.damages] == ([] if log == "header" else [path])
    with open_episode(dataset / episode_path(episode().id)) as found:
        assert len(found.metadata.quality) == len(one.damages)


@pytest.mark.parametrize(("name", "step"), [("pose", 1), ("camera", 31)])
def test_a_log_is_cut_in_its_last_record(dataset: Path, name: str, step: int) -> None:
    given = samples(name, 8, 30.0)
    journal = make_journal(dataset, {name: (PORTS[name], given)})
    log = journal / name / segment_name(0)
    whole, size = log.read_bytes(), HEADER_BYTES + len(PAYLOADS[name](7))
    for rest in range(0, size, step):
        os.truncate(log, len(whole) - size + rest)
        found = inspect(journal)
        assert found.samples == {name: 7}
        reported = [(damage.path, damage.bytes) for damage in found.damages]
        assert reported == ([(log, rest)] if rest else [])
        log.write_bytes(whole)
    log.write_bytes(whole[: -size // 2])
    assert recover([dataset]).done[0].samples == {name: 7}
    path = dataset / episode_path(episode().id)
    assert [one for one in validate(path).problems if one.severity == "error"] == []


def test_random_corruption_of_any_file_costs_only_what_it_hits(dataset: Path) -> None:
    given = {"pose": (POSE, samples("pose", 30, 90.0)), "camera": (CAMERA, samples("camera", 9))}
    rng = np.random.default_rng(5)
    for number in range(1, 15):
        journal = make_journal(dataset, given, metadata=episode(number), state="recording")
        files = sorted(
            path for path in journal.rglob("*") if path.is_file() and path.stat().st_size
        )
        path = files[number % len(files)]
        spoilt = bytearray(path.read_bytes())
        for at in rng.integers(len(spoilt), size=2):
            spoilt[at] ^= int(rng.integers(1, 256))
        path.write_bytes(spoilt)
        (one,) = recover([journal]).done
        assert one.samples is not None
        for name, (_, sent) in given.items():
            missing = len(sent) - one.samples[name]
            told = sum(each.bytes > 0 for each in one.damages if each.path.parent.name == name)
            assert bool(told) == bool(missing) == (path.parent.name == name), path
            assert missing <= 2
        target = dataset / episode_path(episode(number).id)
        assert [each for each in validate(target).problems if each.severity == "error"] == []


def test_a_full_disk_keeps_the_journal(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 5, 90.0))})
    before = contents(journal)
    reserve = dataset / ".recording" / ".reserve"
    reserve.write_bytes(b"left by a crash")

    def full(*_: object, **__: object) -> None:
        assert not reserve.exists()  # its room was given back before it was needed
        raise OSError(28, "No space left on device", str(dataset))

    with monkeypatch.context() as patch:
        patch.setattr("exumi_data.store.episode_writer.sync_tree", full)
        result = recover([dataset])
    assert "No space left" in result.failed[0][1]
    assert contents(journal) == before
    assert not list(dataset.rglob(".partial-*"))
    assert recover([dataset]).done[0].outcome == "finalised"


def test_what_was_discarded_stays_until_it_is_taken_back(dataset: Path) -> None:
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 5, 90.0))})
    discard(journal, "dropped")
    before = contents(dataset)
    assert [one.outcome for one in recover([dataset]).done] == ["discarded"]
    assert contents(dataset) == before
    undo_discard(journal)
    assert [one.outcome for one in recover([dataset]).done] == ["finalised"]


def test_a_journal_that_was_never_begun_goes(dataset: Path) -> None:
    journal = make_journal(dataset, {"pose": (POSE, [])})
    (journal / "header.json").unlink()
    shutil.rmtree(journal / "clock")
    assert [one.outcome for one in recover([journal]).done] == ["empty"]
    assert not journal.exists()
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 2))})
    (journal / "header.json").unlink()
    shutil.rmtree(journal / "header")
    assert "header.json" in recover([journal]).failed[0][1]
    assert journal.exists()


def test_a_damaged_episode_in_the_way_is_told(dataset: Path) -> None:
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 2))})
    (dataset / episode_path(episode().id)).mkdir(parents=True)
    assert "Move it away" in recover([journal]).failed[0][1]
    assert read_state(journal).state == "stopped"


def test_the_catalog_grows(dataset: Path) -> None:
    for number in (1, 2):
        make_journal(dataset, {"pose": (POSE, samples("pose", 5))}, metadata=episode(number))
        recover([dataset])
        table = read_catalog(dataset)
        assert table is not None
        assert table.num_rows == number
    (dataset / "catalog.parquet").write_text("no catalog")
    make_journal(dataset, {"pose": (POSE, samples("pose", 5))}, metadata=episode(3))
    assert "exumi index" in recover([dataset]).notices[0]
    assert (dataset / "catalog.parquet").read_text() == "no catalog"


def test_finalising_at_the_same_time_loses_nothing_of_the_catalog(dataset: Path) -> None:
    journals = [
        make_journal(dataset, {"pose": (POSE, samples("pose", 5))}, metadata=episode(number))
        for number in range(1, 9)
    ]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda journal: recover([journal]), journals))
    table = read_catalog(dataset)
    assert table is not None
    assert table.num_rows == len(journals)


def test_a_folder_whose_name_is_no_text(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path / "\udcff")
    make_journal(dataset, {"pose": (POSE, samples("pose", 5))})
    result = recover([dataset])
    assert ([one.outcome for one in result.done], result.notices) == (["finalised"], ())


def test_paths_that_hold_no_journal_are_refused(tmp_path: Path, dataset: Path) -> None:
    for path in (tmp_path / "gone", tmp_path):
        with pytest.raises(UsageError):
            find_journals(path)
    (tmp_path / "loose.rec").mkdir()
    with pytest.raises(UsageError, match="no journal in the folder"):
        find_journals(tmp_path / "loose.rec")
    journal = make_journal(dataset, {"pose": (POSE, [])})
    assert find_journals(dataset) == find_journals(dataset / ".recording") == [journal]
    assert find_journals(journal) == [journal]


# -------------------------------------------------------------------------------- the command line


def test_the_command_says_what_it_did(dataset: Path) -> None:
    journal = make_journal(dataset, {"camera": (CAMERA, samples("camera", 20))}, state="recording")
    log = journal / "camera" / segment_name(0)
    log.write_bytes(log.read_bytes()[:-3])
    before = contents(dataset)
    dry = CliRunner().invoke(app, ["recover", str(dataset), "--dry-run"])
    assert dry.exit_code == 0
    assert "19 samples, not finalised; the recorder ended without stopping" in dry.stdout
    assert contents(dataset) == before
    done = CliRunner().invoke(app, ["recover", str(dataset), "--format", "json"])
    assert done.exit_code == 0
    (one,) = json.loads(done.stdout)["journals"]
    assert one["outcome"] == "finalised"
    assert one["samples"] == {"camera": 19}
    assert one["damages"][0]["what"] == "no whole record follows"
    again = CliRunner().invoke(app, ["recover", str(dataset)])
    assert again.stdout == "nothing to recover\n"


def test_the_command_fails_where_a_journal_does(dataset: Path) -> None:
    journal = make_journal(dataset, {"camera": (CAMERA, samples("camera", 2))})
    spoil_header(journal)
    result = CliRunner().invoke(app, ["recover", str(dataset)])
    assert result.exit_code == 1
    assert "header.json" in result.stderr
    assert CliRunner().invoke(app, ["recover", str(dataset / "gone")]).exit_code == 2
