"""Datasets: serial and parallel alike, nothing lost on the way."""

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from exumi_data.catalog import episode_path
from exumi_data.errors import NotAnEpisodeError, UnsupportedError, UsageError
from exumi_validators import validate
from tests.exumi_data.builders import edit_metadata, episode_id, write_dataset, write_small


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten episodes, of which one has lost a shard and one has an unknown key."""
    root = write_dataset(tmp_path_factory.mktemp("data") / "d", 10)
    (root / episode_path(episode_id(3)) / "streams/width/time/c/0").unlink()
    edit_metadata(root / episode_path(episode_id(5)), lambda exumi: exumi.update(colour="red"))
    return root


def test_processes_find_what_one_finds(dataset: Path) -> None:
    assert validate(dataset, workers=2).to_json() == validate(dataset, workers=1).to_json()


def test_places_name_the_episode(dataset: Path) -> None:
    report = validate(dataset, levels=["document", "arrays"], workers=1)
    missing = next(p for p in report.problems if p.code == "SHARD-001")
    assert missing.location.episode == episode_path(episode_id(3))
    assert missing.location.path == "streams/width/time"
    assert missing.location.file == f"{episode_path(episode_id(3))}/streams/width/time"
    assert report.codes()["META-003"] == 1


def test_progress_counts_all(dataset: Path) -> None:
    seen: list[tuple[int, int]] = []
    validate(
        dataset,
        levels=["document"],
        workers=1,
        on_progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(done, 10) for done in range(1, 11)]


def test_changed_bytes_are_told_by_the_digest(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 2)
    shard = root / episode_path(episode_id(0)) / "streams/tactile/data/c/0"
    data = bytearray(shard.read_bytes())
    data[100] ^= 1
    shard.write_bytes(bytes(data))
    found = validate(root).codes()
    assert found["CAT-004"] == 1
    assert found["IMG-005"] == 1


def test_an_unfinished_episode_alone(tmp_path: Path) -> None:
    path = write_small(tmp_path / "e.zarr")
    (path / "zarr.json").unlink()
    aside = path.rename(tmp_path / ".partial-1")
    assert validate(aside).codes() == {"ROOT-001": 1}


def test_a_dataset_without_its_head_is_still_judged(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 2)
    (root / "dataset.json").unlink()
    report = validate(root, levels=["document"])
    assert report.kind == "dataset"
    assert report.codes()["SET-001"] == 1
    assert report.coverage.episodes == 2


def test_a_newer_dataset_is_refused_whole(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 2)
    head = root / "dataset.json"
    head.write_text(head.read_text().replace('"1.0"', '"2.0"'))
    report = validate(root)
    assert report.codes()["DOC-005"] == 1
    assert report.coverage.episodes == 0
    assert not report.valid


@pytest.mark.parametrize("content", ["nothing", "folder", "text"])
def test_what_is_none_could_not_run(tmp_path: Path, content: str) -> None:
    path = tmp_path / "x"
    if content == "folder":
        path.mkdir()
    elif content == "text":
        path.write_text("hello")
    with pytest.raises(NotAnEpisodeError):
        validate(path)


def test_a_url_could_not_run() -> None:
    with pytest.raises(UnsupportedError):
        validate("https://example.org/data")


@pytest.mark.parametrize("levels", [["everything"], []])
def test_unknown_levels_could_not_run(good: Path, levels: list[str]) -> None:
    with pytest.raises(UsageError, match="Supported values are document, hierarchy, arrays, data"):
        validate(good, levels=levels)


def test_validating_writes_nothing(good: Path, tmp_path: Path) -> None:
    shutil.copytree(good, tmp_path / "e.zarr")
    before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")}
    validate(tmp_path / "e.zarr")
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")} == before


def test_an_empty_path_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(write_dataset(tmp_path / "d", 1))
    assert validate(".").valid
    with pytest.raises(NotAnEpisodeError, match="empty path"):
        validate("")


def test_a_split_may_name_an_episode_that_cannot_be_read(tmp_path: Path) -> None:
    """It is there, and only damaged: the split need not be made again."""
    root = write_dataset(tmp_path / "d", 2)
    (root / "splits").mkdir()
    lists = {"train": [episode_id(0)], "test": [episode_id(1)]}
    split = {"format": "exumi-split", "version": "1.0", "name": "a", "level": "episode"}
    (root / "splits/a.json").write_text(json.dumps({**split, "lists": lists}))
    document = json.loads((root / "dataset.json").read_text())
    (root / "dataset.json").write_text(json.dumps({**document, "splits": ["a"]}))
    assert "SPLIT-004" not in validate(root).codes()
    (root / episode_path(episode_id(1)) / "zarr.json").write_text("{")
    found = validate(root).codes()
    assert found["DOC-001"] == 1
    assert "SPLIT-004" not in found
    shutil.rmtree(root / episode_path(episode_id(1)))
    assert validate(root).codes()["SPLIT-004"] == 1


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("regime", "play", '"play"'),
        ("task", "x" * 200, "what has sha-256 "),
        ("licence", None, "nothing"),
        ("labels", [{"property": "hardness", "number": 3.0, "text": None}], '"number": 3.0'),
        ("quality", ["dark"], '["dark"]'),
    ],
)
def test_whatever_a_row_holds_of_the_metadata_is_compared(
    tmp_path: Path, column: str, value: object, told: str
) -> None:
    root = write_dataset(tmp_path / "d", 2)
    assert "CAT-003" not in validate(root, levels=["hierarchy"]).codes()
    table = pq.read_table(root / "catalog.parquet")
    values = table[column].to_pylist()
    values[1] = value
    field = table.schema.field(column).with_nullable(True)
    column_at = table.schema.get_field_index(column)
    pq.write_table(
        table.set_column(column_at, field, pa.array(values, field.type)), root / "catalog.parquet"
    )
    (found,) = [p for p in validate(root, levels=["hierarchy"]).problems if p.code == "CAT-003"]
    assert found.location.index == 1
    assert found.message.startswith(f"{column} of ")
    assert told in found.message
