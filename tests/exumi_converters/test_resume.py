"""Runs that are repeated, interrupted, killed, or meet what others left behind."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from exumi_converters import ConversionReport, ConvertOptions, Progress, convert
from exumi_data.catalog import episode_path, list_episodes, read_catalog
from exumi_data.dataset import Dataset, open_dataset
from exumi_data.destination import only_run
from exumi_data.episode import open_episode
from exumi_data.errors import UsageError
from exumi_data.store.pack import pack

Run = Callable[..., tuple[ConversionReport, Dataset]]


def times_of(root: Path) -> dict[str, int]:
    return {
        path.relative_to(root).as_posix(): path.stat().st_mtime_ns
        for path in root.rglob("*")
        if path.is_file()
    }


def digests(dataset: Dataset) -> dict[str, str]:
    return {episode.id: episode.digest() for episode in dataset}


def counts(report: ConversionReport) -> tuple[int, int, int]:
    return report.converted, report.skipped, len(report.failed)


def test_a_second_run_changes_no_file(octopi: Path, labels: Path, run: Run, tmp_path: Path) -> None:
    first, _ = run(octopi, "octopi", labels=labels)
    before = times_of(tmp_path / "out")
    second, dataset = run(octopi, "octopi", labels=labels)
    assert counts(second) == (0, 5, 0)
    assert second.frames == 0
    assert times_of(tmp_path / "out") == before
    assert second.flagged == first.flagged  # what was odd is said again
    assert len(dataset) == 5


def test_the_same_source_gives_the_same_bytes_anywhere(
    octopi: Path, run: Run, tmp_path: Path
) -> None:
    _, here = run(octopi, "octopi")
    shutil.move(octopi, tmp_path / "moved")
    _, there = run(tmp_path / "moved", "octopi", to="elsewhere", workers=2, durable=True)
    assert digests(here) == digests(there)
    derived = {episode.id: episode.store.read("derived/zarr.json") for episode in here}
    assert derived == {episode.id: episode.store.read("derived/zarr.json") for episode in there}


def test_a_changed_label_makes_one_episode_again(
    octopi: Path, labels: Path, run: Run, tmp_path: Path
) -> None:
    _, dataset = run(octopi, "octopi", labels=labels)
    before = times_of(tmp_path / "out")
    labels.write_text(labels.read_text().replace("a scoop of rice,2.33", "a scoop of rice,3.33"))
    report, dataset = run(octopi, "octopi", labels=labels)
    assert counts(report) == (1, 4, 0)
    revisions = {e.metadata.source.key: e.metadata.revision for e in dataset}
    assert revisions.pop("rice_0.mov") == 2
    assert set(revisions.values()) == {1}
    (rice,) = [e for e in dataset if e.metadata.source.key == "rice_0.mov"]
    changed = {
        path for path, time in times_of(tmp_path / "out").items() if before.get(path) != time
    }
    assert {path.split("/")[0] for path in changed} == {"episodes", "catalog.parquet"}
    assert all(rice.id in path for path in changed if path.startswith("episodes"))
    (row,) = dataset.select([rice.id]).catalog.to_pylist()
    assert (row["revision"], row["labels"][0]["number"]) == (2, 3.33)


def test_options_that_shape_episodes_make_them_again(octopi: Path, run: Run) -> None:
    run(octopi, "octopi")
    report, dataset = run(octopi, "octopi", licence="CC-BY-4.0", task="poke")
    assert counts(report) == (5, 0, 0)
    assert {e.metadata.licence for e in dataset} == {dataset.metadata.licence} == {"CC-BY-4.0"}
    assert {e.metadata.revision for e in dataset} == {2}
    report, _ = run(octopi, "octopi", licence="CC-BY-4.0", task="poke", workers=2, keep_going=True)
    assert counts(report) == (0, 5, 0)


def test_a_damaged_episode_is_repaired_under_the_same_revision(
    octopi: Path, run: Run, tmp_path: Path
) -> None:
    _, dataset = run(octopi, "octopi")
    before = digests(dataset)
    places = [tmp_path / "out" / path for path in dataset.catalog.column("path").to_pylist()]
    shutil.rmtree(places[0] / "streams" / "tactile" / "data" / "c")
    (places[1] / "zarr.json").write_text("{}")
    shutil.rmtree(places[2] / "derived")
    report, dataset = run(octopi, "octopi")
    assert counts(report) == (3, 2, 0)
    assert digests(dataset) == before
    for episode in dataset:
        episode.check_complete()
        assert episode["tactile"].activity is not None


def test_a_changed_file_is_another_episode_and_the_old_one_is_mentioned(
    octopi: Path, run: Run, make_clip: Any
) -> None:
    run(octopi, "octopi")
    make_clip(octopi / "egg_0.mov", 36, seed=99)
    report, dataset = run(octopi, "octopi")
    assert counts(report) == (1, 4, 0)
    assert len(report.unexplained) == 1
    assert report.unexplained[0].startswith("episodes/")
    assert len(dataset) == 6


def test_a_changed_table_is_a_new_revision_of_the_same_episode(
    tmp_path: Path, make_clip: Any, run: Run
) -> None:
    make_clip(tmp_path / "in" / "a_0.avi", 5, codec="mjpeg")
    (tmp_path / "in" / "a_0.csv").write_text("force_N\n1\n2\n3\n4\n5\n")
    _, dataset = run(tmp_path / "in", "clips")
    first = dataset.ids
    (tmp_path / "in" / "a_0.csv").write_text("force_N\n1\n2\n3\n4\n6\n")
    report, dataset = run(tmp_path / "in", "clips")
    assert dataset.ids == first
    assert counts(report) == (1, 0, 0)
    assert dataset[0].metadata.revision == 2
    assert dataset[0]["force"].data[-1, 0] == 6
    # A table that has become wrong leaves the episode as it was.
    (tmp_path / "in" / "a_0.csv").write_text("force_N\n1\n")
    report, dataset = run(tmp_path / "in", "clips")
    assert counts(report) == (0, 0, 1)
    assert "The episode of an earlier run was kept." in report.failed[0].reason
    assert dataset[0]["force"].data[-1, 0] == 6
    assert report.unexplained == ()


def test_a_packed_episode_counts_and_is_replaced_by_what_is_made_anew(
    octopi: Path, run: Run, tmp_path: Path
) -> None:
    _, dataset = run(octopi, "octopi")
    place = tmp_path / "out" / dataset.catalog.column("path")[0].as_py()
    packed = pack(place)
    shutil.rmtree(place)
    report, dataset = run(octopi, "octopi")
    assert counts(report) == (0, 5, 0)
    packed.write_bytes(packed.read_bytes()[:-100])
    report, dataset = run(octopi, "octopi")
    assert counts(report) == (1, 4, 0)
    assert not packed.exists()
    assert len(dataset) == 5


def test_what_a_killed_run_left_is_cleaned(octopi: Path, run: Run, tmp_path: Path) -> None:
    _, dataset = run(octopi, "octopi")
    before = digests(dataset)
    out = tmp_path / "out"
    places = [out / path for path in dataset.catalog.column("path").to_pylist()]
    # Killed while writing one anew: half of it lies under its partial name.
    half = places[0].with_name(f".partial-{dataset.ids[0]}")
    half.mkdir()
    (half / "streams").mkdir()
    (half / "streams" / "x").write_text("half")
    # Killed between the two renames: the old one waits, the new one is not there yet.
    aside = places[1].with_name(f".replaced-{places[1].name}")
    places[1].rename(aside)
    # Killed after them: the old one is still there.
    shutil.copytree(places[2], places[2].with_name(f".replaced-{places[2].name}"))
    (out / ".partial-1234-catalog.parquet").write_text("half")
    report, dataset = run(octopi, "octopi")
    assert counts(report) == (0, 5, 0)
    assert report.notices == (
        "2 half-written episode(s) of an earlier run were removed",
        "1 episode(s) that an earlier run had put aside were brought back",
    )
    assert digests(dataset) == before
    assert not [path for path in out.rglob(".*") if path.is_file() or path.is_dir()]


def test_a_missing_or_stale_catalog_is_written_anew(octopi: Path, run: Run, tmp_path: Path) -> None:
    _, dataset = run(octopi, "octopi")
    expected = read_catalog(tmp_path / "out")
    (tmp_path / "out" / "catalog.parquet").unlink()
    run(octopi, "octopi")
    assert read_catalog(tmp_path / "out").equals(expected)  # type: ignore[union-attr]  # there is one
    foreign = dataset[0]
    other = tmp_path / "out" / episode_path("00000000-0000-4000-8000-0000000000ff")
    shutil.copytree(foreign.path, other)
    root = json.loads((other / "zarr.json").read_text())
    root["attributes"]["exumi"]["id"] = "00000000-0000-4000-8000-0000000000ff"
    (other / "zarr.json").write_text(json.dumps(root))
    report, dataset = run(octopi, "octopi")
    assert len(dataset) == 6
    assert report.unexplained == (episode_path("00000000-0000-4000-8000-0000000000ff"),)


def test_an_episode_that_cannot_be_read_does_not_stop_the_catalog(
    octopi: Path, run: Run, tmp_path: Path
) -> None:
    run(octopi, "octopi")
    bad = tmp_path / "out" / episode_path("00000000-0000-4000-8000-0000000000ff")
    bad.mkdir(parents=True)
    chosen = ConvertOptions(workers=1)
    report = convert(octopi, tmp_path / "out", from_format="octopi", options=chosen)
    assert any("not in the catalog" in text and bad.name in text for text in report.notices)
    assert len(read_catalog(tmp_path / "out")) == 5  # type: ignore[arg-type]  # there is one


def test_two_runs_into_one_dataset_are_refused(octopi: Path, run: Run, tmp_path: Path) -> None:
    run(octopi, "octopi")
    with (
        only_run(tmp_path / "out"),
        pytest.raises(UsageError, match="another command is writing into this dataset"),
    ):
        convert(octopi, tmp_path / "out", from_format="octopi")


def test_a_destination_that_holds_something_else_is_refused(octopi: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("x")
    with pytest.raises(UsageError, match="exists and is no exUMI dataset"):
        convert(octopi, tmp_path / "out", from_format="octopi")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.tex"]
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError):
        convert(octopi, tmp_path / "file", from_format="octopi")


def test_progress_is_told_of_every_episode(octopi: Path, run: Run, tmp_path: Path) -> None:
    (octopi / "bad_0.mov").write_text("x")
    told: list[Progress] = []
    chosen = ConvertOptions(workers=2)
    report = convert(
        octopi, tmp_path / "out", from_format="octopi", options=chosen, on_progress=told.append
    )
    assert [item.done for item in told] == [1, 2, 3, 4, 5, 6]
    assert {item.total for item in told} == {6}
    assert {item.name: item.status for item in told}["bad_0.mov"] == "failed"
    assert told[-1].frames == report.frames == 150
    assert json.loads(json.dumps(report.to_json()))["failed"][0]["name"] == "bad_0.mov"


# --------------------------------------------------------------------------------- real processes

PROGRAM = """
import sys
from exumi_converters import ConvertOptions, convert

def main() -> None:
    told = lambda progress: print(progress.done, flush=True)
    options = ConvertOptions(workers=2)
    convert(sys.argv[1], sys.argv[2], from_format="octopi", options=options, on_progress=told)

if __name__ == "__main__":
    main()
"""


@pytest.fixture
def many(tmp_path: Path, make_clip: Any) -> Path:
    clip = make_clip(tmp_path / "clip.mov", 150).read_bytes()
    (tmp_path / "many").mkdir()
    for trial in range(40):
        (tmp_path / "many" / f"egg_{trial}.mov").write_bytes(clip)
    return tmp_path / "many"


def start(tmp_path: Path, source: Path) -> "subprocess.Popen[str]":
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, str(program), str(source), str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) >= 3:
            break
    return process


def check_whole(out: Path) -> int:
    """Check that what bears a final name is whole; return how many there are."""
    paths = list_episodes(out)
    for path in paths:
        with open_episode(out / path) as episode:
            episode.check_complete()
            assert len(episode["tactile"].frames[:]) == 150
    return len(paths)


def test_a_run_that_was_killed_is_taken_up(many: Path, tmp_path: Path, run: Run) -> None:
    process = start(tmp_path, many)
    process.kill()
    process.communicate(timeout=60)  # its workers end with it, or this would not return
    before = check_whole(tmp_path / "out")
    assert 3 <= before < 40
    report, dataset = run(many, "octopi")
    converted, skipped, failed = counts(report)
    # Workers of the killed run may finish the clips that they were at.
    assert (converted + skipped, failed) == (40, 0)
    assert skipped >= before
    _, whole = run(many, "octopi", to="in-one-go")
    assert digests(dataset) == digests(whole)
    assert not list((tmp_path / "out").rglob(".partial-*"))
    assert not list((tmp_path / "out").rglob(".replaced-*"))


def test_ctrl_c_stops_cleanly(many: Path, tmp_path: Path, run: Run) -> None:
    process = start(tmp_path, many)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode != 0
    before = check_whole(tmp_path / "out")
    assert 3 <= before < 40
    assert not list((tmp_path / "out").rglob(".partial-*"))
    with pytest.warns(match="the catalog is missing"):
        assert len(open_dataset(tmp_path / "out")) == before
    report, _ = run(many, "octopi")
    assert counts(report) == (40 - before, before, 0)
