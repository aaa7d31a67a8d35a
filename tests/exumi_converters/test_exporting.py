"""Writing other formats: whole or not at all, resumable, honest about what is lost."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_converters import (
    ExportItem,
    ExportOptions,
    ExportPlan,
    Failure,
    FormatOptions,
    Loss,
    Part,
    export,
    plan_export,
    registry,
)
from exumi_data import Dataset, Episode, EpisodeWriter
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import (
    Clock,
    DatasetMetadata,
    EpisodeMetadata,
    Source,
    Task,
)

COUNT = 3


class Widths:
    """A format of one file: a line of widths an episode."""

    name = "widths"
    version = "1"
    describes = "a line an episode"
    keeps: tuple[str, ...] = ("widths",)
    loses: Mapping[str, str] = {"time": "only the order is kept"}
    options: type[FormatOptions] = FormatOptions
    failing: set[str] = set()  # noqa: RUF012  # one exporter, told by the tests
    written: list[str] = []  # noqa: RUF012  # same

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        refused = tuple(
            Failure(e.id, "it has no width") for e in dataset if "width" not in e.streams
        )
        named = {failure.name for failure in refused}
        ids = [name for name in dataset.ids if name not in named]
        return ExportPlan(
            layout="lines",
            items=tuple(ExportItem(id=name, index=i) for i, name in enumerate(ids)),
            writes="folder" if options.settings.get("folder") else "file",
            losses=(Loss(facet="time", detail="only the order is kept", stream="width"),),
            refused=refused,
        )

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        assert not any(folder.iterdir())
        (folder / "line").write_text(" ".join(map(str, episode["width"].data)))
        if item.id in self.failing:
            raise SourceError("it is cursed", where=item.id)
        self.written.append(item.id)
        return {"frames": len(episode["width"])}

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        text = "\n".join((part.folder / "line").read_text() for part in parts)
        (target / "lines" if target.is_dir() else target).write_text(text)


@pytest.fixture
def widths(monkeypatch: pytest.MonkeyPatch) -> Widths:
    exporter = Widths()
    monkeypatch.setattr(Widths, "failing", set())
    monkeypatch.setattr(Widths, "written", [])
    monkeypatch.setattr(registry, "_OWN_EXPORTERS", {"widths": exporter})
    return exporter


def add_episode(root: Path, number: int, *, stream: str = "width") -> str:
    metadata = EpisodeMetadata(
        id=str(uuid.uuid5(uuid.NAMESPACE_URL, str(number))),
        task=Task(name="close"),
        regime="play",
        licence="CC0-1.0",
        source=Source(type="simulated", tool="test", tool_version="1"),
    )
    path = root / episode_path(metadata.id)
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, metadata) as writer:
        clock = Clock(source="hub", stamp_point="user_rx")
        width = writer.add_stream(stream, kind="width", clock=clock)
        width.append(np.arange(5) * 10_000_000, np.full(5, number / 100, np.float32))
    return metadata.id


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    root = tmp_path / "data"
    create_dataset(root, DatasetMetadata(name="data", licence="CC0-1.0"))
    for number in range(COUNT):
        add_episode(root, number)
    write_catalog(root, build_catalog(root)[0])
    return root


ONE = ExportOptions(workers=1, durable=False)


def test_parts_become_a_file_in_the_datasets_order(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    told: list[ExportPlan] = []
    seen: list[str] = []
    report = export(
        dataset,
        tmp_path / "out.txt",
        to_format="widths",
        options=ONE,
        on_plan=told.append,
        on_progress=lambda now: seen.append(f"{now.done}/{now.total} {now.status}"),
    )
    lines = (tmp_path / "out.txt").read_text().splitlines()
    expected = [" ".join(map(str, e["width"].data)) for e in open_dataset(dataset)]
    assert lines == expected
    assert (report.written, report.total, report.frames) == (COUNT, COUNT, 5 * COUNT)
    assert report.complete
    assert report.bytes == (tmp_path / "out.txt").stat().st_size
    assert told[0].losses[0].facet == "time"
    assert seen == ["1/3 converted", "2/3 converted", "3/3 converted"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "out.txt"]
    json.dumps(report.to_json())


def test_one_episode_is_a_dataset_of_one(widths: Widths, dataset: Path, tmp_path: Path) -> None:
    episode = open_dataset(dataset)[1]
    report = export(episode.path, tmp_path / "one.txt", to_format="widths", options=ONE)
    assert report.written == 1
    assert widths.written == [episode.id]


def test_a_folder_says_where_it_came_from_and_is_left_alone_when_complete(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    told = ExportOptions(workers=1, durable=False, settings={"folder": "yes"})
    (tmp_path / "out").mkdir()  # an empty folder is as good as none
    export(dataset, tmp_path / "out", to_format="widths", options=told)
    about = json.loads((tmp_path / "out" / "exumi_export.json").read_text())
    assert about["exporter"] == "widths/1"
    assert [entry["id"] for entry in about["episodes"]] == open_dataset(dataset).ids
    assert about["lost"][0]["facet"] == "time"
    widths.written.clear()
    again = export(dataset, tmp_path / "out", to_format="widths", options=told)
    assert (again.written, again.skipped, widths.written) == (0, COUNT, [])
    # Of other episodes it is another export.
    add_episode(dataset, COUNT)
    write_catalog(dataset, build_catalog(dataset)[0])
    with pytest.raises(UsageError, match="exists already"):
        export(dataset, tmp_path / "out", to_format="widths", options=told)


@pytest.mark.parametrize("what", ["file", "folder", "link"])
def test_what_is_there_is_never_overwritten(
    widths: Widths, dataset: Path, tmp_path: Path, what: str
) -> None:
    target = tmp_path / "out.txt"
    if what == "file":
        target.write_text("precious")
    elif what == "folder":
        target.mkdir()
        (target / "thesis").write_text("precious")
    else:
        target.symlink_to(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="exists already"):
        export(dataset, target, to_format="widths", options=ONE)
    assert widths.written == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "out.txt"]


def test_a_failure_keeps_the_parts_and_the_next_run_goes_on(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    target = tmp_path / "out.txt"
    cursed = open_dataset(dataset).ids[1]
    widths.failing.add(cursed)
    report = export(dataset, target, to_format="widths", options=ONE)
    assert not target.exists()
    assert report.written == 0
    assert report.failed == (Failure(cursed, f"{cursed}: it is cursed"),)
    assert any("run again" in line for line in report.notices)
    widths.failing.clear()
    widths.written.clear()
    report = export(dataset, target, to_format="widths", options=ONE)
    assert widths.written == [cursed]
    assert report.written == COUNT
    assert len(target.read_text().splitlines()) == COUNT
    assert not list(tmp_path.glob(".partial-*"))


def test_keep_going_leaves_out_what_fails_and_says_so(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    cursed = open_dataset(dataset).ids[0]
    widths.failing.add(cursed)
    told = ExportOptions(workers=1, durable=False, keep_going=True, settings={"folder": "yes"})
    report = export(dataset, tmp_path / "out", to_format="widths", options=told)
    assert (report.written, len(report.failed)) == (COUNT - 1, 1)
    about = json.loads((tmp_path / "out" / "exumi_export.json").read_text())
    assert cursed not in [entry["id"] for entry in about["episodes"]]


def test_episodes_that_do_not_fit_are_refused_before_anything_is_written(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    other = add_episode(dataset, 9, stream="opening")
    write_catalog(dataset, build_catalog(dataset)[0])
    target = tmp_path / "out.txt"
    with pytest.raises(UsageError, match=f"1 of 4 .* {other}: it has no width"):
        export(dataset, target, to_format="widths", options=ONE)
    assert widths.written == []
    told = ExportOptions(workers=1, durable=False, keep_going=True)
    report = export(dataset, target, to_format="widths", options=told)
    assert (report.written, report.failed[0].name) == (COUNT, other)


def test_parts_of_another_export_are_not_used(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    target = tmp_path / "out.txt"
    widths.failing.add(open_dataset(dataset).ids[1])
    export(dataset, target, to_format="widths", options=ONE)
    widths.failing.clear()
    widths.written.clear()
    told = ExportOptions(workers=1, durable=False, settings={"other": "1"})
    report = export(dataset, target, to_format="widths", options=told)
    assert sorted(widths.written) == sorted(open_dataset(dataset).ids)
    assert "what another export had left unfinished there was removed" in report.notices


def test_a_damaged_episode_is_not_written_as_zeros(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    episode = open_dataset(dataset)[0]
    for shard in Path(episode.path, "streams", "width", "data", "c").iterdir():
        shard.unlink()
    report = export(dataset, tmp_path / "out.txt", to_format="widths", options=ONE)
    assert [failure.name for failure in report.failed] == [episode.id]
    assert "missing" in report.failed[0].reason


def test_nothing_to_write_and_unknown_formats_are_refused(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r"Invalid format \(zoo\). Supported values are widths"):
        export(dataset, tmp_path / "out", to_format="zoo")
    create_dataset(tmp_path / "empty", DatasetMetadata(name="empty", licence="CC0-1.0"))
    with pytest.raises(UsageError, match="there is no episode"):
        plan_export(tmp_path / "empty", tmp_path / "out", to_format="widths")


KILLED = """
import sys, time
sys.path.insert(0, sys.argv[1])
import test_exporting as t
from exumi_converters import export, registry

class Slow(t.Widths):
    def write(self, item, episode, folder, plan):
        print("part", flush=True)
        done = super().write(item, episode, folder, plan)
        time.sleep(0.4 if len(self.written) > 1 else 0)
        return done

registry._OWN_EXPORTERS = {"widths": Slow()}
export(sys.argv[2], sys.argv[3], to_format="widths", options=t.ONE)
"""


def test_a_killed_run_leaves_nothing_under_the_final_name_and_is_gone_on_with(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    target = tmp_path / "out.txt"
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(Path(__file__).parent), str(dataset), str(target)],
        stdout=subprocess.PIPE,
        text=True,
    ) as run:
        assert run.stdout is not None
        assert [run.stdout.readline() for _ in range(2)] == ["part\n", "part\n"]
        time.sleep(0.1)
        run.send_signal(signal.SIGKILL)
    assert not target.exists()
    report = export(dataset, target, to_format="widths", options=ONE)
    assert report.written == COUNT
    assert widths.written == open_dataset(dataset).ids[1:]
    assert not list(tmp_path.glob(".partial-*"))


def test_parts_survive_a_stop_while_they_are_put_together(
    widths: Widths, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "out.txt"

    def move_and_stop(self: Widths, parts: Sequence[Part], target: Path, *_: object) -> None:
        for part in parts:
            (part.folder / "line").rename(target)
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Widths, "assemble", move_and_stop)
        with pytest.raises(OSError, match="No space left"):
            export(dataset, target, to_format="widths", options=ONE)
    assert not target.exists()
    widths.written.clear()
    export(dataset, target, to_format="widths", options=ONE)
    assert widths.written == []
    assert len(target.read_text().splitlines()) == COUNT


def test_without_links_parts_are_written_again_after_a_stop(
    widths: Widths, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_link(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_link)
    target = tmp_path / "out.txt"
    with monkeypatch.context() as patched:
        patched.setattr(Widths, "assemble", no_link)
        with pytest.raises(OSError, match="not permitted"):
            export(dataset, target, to_format="widths", options=ONE)
    export(dataset, target, to_format="widths", options=ONE)
    assert len(widths.written) == 2 * COUNT
    assert len(target.read_text().splitlines()) == COUNT


def test_what_could_not_be_written_takes_no_room(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    widths.failing.update(open_dataset(dataset).ids)
    export(dataset, tmp_path / "out.txt", to_format="widths", options=ONE)
    assert [path.name for path in (tmp_path / ".partial-out.txt").iterdir()] == ["plan.json"]


def test_digests_are_those_of_the_episodes_not_of_a_catalog_left_behind(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    told = ExportOptions(workers=1, durable=False, settings={"folder": "yes"})
    export(dataset, tmp_path / "out", to_format="widths", options=told)
    document = Path(open_dataset(dataset)[0].path, "zarr.json")
    document.write_text(document.read_text().replace('"close"', '"open"'))
    with pytest.raises(UsageError, match="is not this export of these episodes"):
        export(dataset, tmp_path / "out", to_format="widths", options=told)
    export(dataset, tmp_path / "new", to_format="widths", options=told)
    about = json.loads((tmp_path / "new" / "exumi_export.json").read_text())
    write_catalog(dataset, build_catalog(dataset)[0])
    assert [entry["digest"] for entry in about["episodes"]] == [
        episode.digest() for episode in open_dataset(dataset)
    ]


def test_an_episode_that_cannot_be_opened_does_not_end_the_run(
    widths: Widths, dataset: Path, tmp_path: Path
) -> None:
    episode = open_dataset(dataset)[1]
    Path(episode.path, "zarr.json").write_text("{")
    target = tmp_path / "out.txt"
    with pytest.raises(UsageError, match=f"1 of 3 episodes cannot be .* {episode.id}: .*JSON"):
        export(dataset, target, to_format="widths", options=ONE)
    told = ExportOptions(workers=1, durable=False, keep_going=True)
    report = export(dataset, target, to_format="widths", options=told)
    assert (report.written, report.total) == (COUNT - 1, COUNT)
    assert [failure.name for failure in report.failed] == [episode.id]
