"""The catalog says what the episodes say, and is never believed against them."""

import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import exumi_data
from exumi_data import CatalogWarning, Dataset
from exumi_data.catalog import (
    CATALOG_NAME,
    build_catalog,
    catalog_row,
    catalog_schema,
    episode_path,
    fingerprint,
    list_episodes,
    read_catalog,
    rows_to_table,
    write_catalog,
)
from exumi_data.dataset import open_dataset
from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError, ExumiError, MetadataError
from exumi_data.model import Annotations, Label, QualityNote
from exumi_data.store.pack import pack
from tests.exumi_data.builders import (
    edit_json,
    edit_metadata,
    episode_id,
    write_dataset,
    write_episode,
    write_small,
)

IDS = sorted((episode_id(number) for number in range(3)), key=episode_path)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "ds")


def opened(root: Path) -> Dataset:
    """Open a dataset; a warning is an error."""
    return open_dataset(root)


def opened_with_warning(root: Path, word: str) -> Dataset:
    with pytest.warns(CatalogWarning, match=f"the catalog is {word}.*exumi index") as caught:
        dataset = exumi_data.open(root)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert isinstance(dataset, Dataset)
    return dataset


def rebuilt(root: Path) -> pa.Table:
    table, failed = build_catalog(root)
    assert not failed
    return table


# --------------------------------------------------------------------------------------------- rows


def test_a_row_says_what_the_episode_says(tmp_path: Path) -> None:
    notes = Annotations(
        object_id="egg",
        part_id="shell",
        instance_id="egg-7",
        trial=3,
        procedure="press",
        pad_type="dotted",
        labels=[
            Label(property="hard", value=3.5, provenance="human"),
            Label(property="what", value=["egg", "round"], provenance="model"),
            Label(property="name", value="egg", provenance="model"),
            Label(property="unknown", value=None, provenance="human"),
        ],
    )
    path = write_episode(
        tmp_path / "a.zarr",
        annotations=notes,
        quality=[QualityNote(code="dark", message="It was dark")],
        start="2025-03-01T00:00:00Z",
        success=False,
    )
    episode = open_episode(path)
    row = catalog_row(episode, "episodes/00/a.zarr")
    files = [p for p in path.rglob("*") if p.is_file()]
    streams = {stream.pop("name"): stream for stream in row.pop("streams")}
    assert row.pop("root_sha256") == episode.root_sha256
    assert len(row.pop("derived_digest")) == 64
    assert row == {
        "id": episode_id(),
        "path": "episodes/00/a.zarr",
        "revision": 1,
        "digest": episode.digest(),
        "bytes": sum(file.stat().st_size for file in files),
        "start": "2025-03-01T00:00:00Z",
        "duration_s": pytest.approx(0.45),
        "regime": "touch",
        "task": "press",
        "success": False,
        "licence": "CC0-1.0",
        "object_id": "egg",
        "part_id": "shell",
        "instance_id": "egg-7",
        "trial": 3,
        "procedure": "press",
        "pad_type": "dotted",
        "labels": [
            {"property": "hard", "number": 3.5, "text": None},
            {"property": "what", "number": None, "text": "egg|round"},
            {"property": "name", "number": None, "text": "egg"},
            {"property": "unknown", "number": None, "text": None},
        ],
        "quality": ["dark"],
    }
    # Activity is 0, 0.005, 0.01, 0.015 and 0.02: four are above 0.001.
    times = {"n": 5, "t0_ns": -50_000_000, "t1_ns": 350_000_000}
    assert streams["pose"] == {"kind": "pose", "encoding": None, "active": None, **times}
    assert streams["tactile"] == {"kind": "tactile", "encoding": "encoded", "active": 4, **times}
    assert streams["rgb"] == {"kind": "rgb", "encoding": "array", "active": None, **times}
    assert streams["gopro"]["encoding"] == "video"
    assert list(streams) == list(episode)
    packed = catalog_row(open_episode(pack(path)), "p")
    assert packed["digest"] == row["digest"]
    assert packed["bytes"] == row["bytes"]


def test_an_empty_episode_has_a_row(tmp_path: Path) -> None:
    from exumi_data.store.episode_writer import EpisodeWriter
    from tests.exumi_data.builders import metadata

    with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
        writer.add_stream("width", kind="width")
    row = catalog_row(open_episode(tmp_path / "a.zarr"), "p")
    assert row["streams"][0]["n"] == row["duration_s"] == 0
    assert row["streams"][0]["t0_ns"] is row["streams"][0]["t1_ns"] is None
    assert rows_to_table([row]).num_rows == 1


def test_the_threshold_of_activity_is_that_of_its_parameters(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "a.zarr")

    def set_threshold(value: Any) -> None:
        edit_json(
            path / "derived" / "zarr.json",
            lambda document: document["attributes"]["exumi"]["items"]["tactile/activity"][
                "parameters"
            ].update(active_above=value),
        )

    def active() -> Any:
        row = catalog_row(open_episode(path), "p")
        return {s["name"]: s["active"] for s in row["streams"]}["tactile"]

    for value, count in ((0.012, 2), (1, 0), (-1, 5)):
        set_threshold(value)
        assert active() == count
    for wrong in ("0.1", None, True, [0.1]):
        set_threshold(wrong)
        with pytest.raises(MetadataError, match="active_above is"):
            active()


# ----------------------------------------------------------------------------------------- the file


def test_a_catalog_is_read_as_it_was_written(root: Path) -> None:
    table = read_catalog(root)
    assert table is not None
    assert table.schema.equals(catalog_schema())
    assert table.column("id").to_pylist() == IDS
    assert table.equals(rebuilt(root))
    dataset = opened(root)
    assert dataset.ids == IDS
    assert dataset.catalog.equals(table)


def test_a_catalog_is_replaced_whole_or_not_at_all(root: Path) -> None:
    before = (root / CATALOG_NAME).read_bytes()
    with pytest.raises(AttributeError):
        write_catalog(root, "no table")
    assert (root / CATALOG_NAME).read_bytes() == before
    assert sorted(path.name for path in root.iterdir()) == [
        CATALOG_NAME,
        "dataset.json",
        "episodes",
    ]


def remove(root: Path) -> None:
    (root / CATALOG_NAME).unlink()


def cut_short(root: Path) -> None:
    content = (root / CATALOG_NAME).read_bytes()
    (root / CATALOG_NAME).write_bytes(content[: len(content) // 2])


def empty(root: Path) -> None:
    (root / CATALOG_NAME).write_bytes(b"")


def text(root: Path) -> None:
    (root / CATALOG_NAME).write_text("id,path\n")


def folder(root: Path) -> None:
    (root / CATALOG_NAME).unlink()
    (root / CATALOG_NAME).mkdir()


def rewritten(change: Any) -> Any:
    def spoil(root: Path) -> None:
        table = pq.ParquetFile(root / CATALOG_NAME).read()
        pq.write_table(change(table), root / CATALOG_NAME)

    return spoil


def other_type(table: pa.Table) -> pa.Table:
    position = table.schema.get_field_index("duration_s")
    return table.set_column(position, "duration_s", pa.array(["x"] * len(table)))


def null_ids(table: pa.Table) -> pa.Table:
    return table.set_column(0, "id", pa.array([None] * len(table), pa.string()))


def twice(table: pa.Table) -> pa.Table:
    return table.append_column("id", table.column("id"))


def no_utf8(table: pa.Table) -> pa.Table:
    buffers = pa.array([b"\xff\xfe"] * len(table)).buffers()
    return table.set_column(
        0, "id", pa.StringArray.from_buffers(len(table), buffers[1], buffers[2])
    )


UNREADABLE = {
    "missing": remove,
    "cut short": cut_short,
    "empty": empty,
    "text": text,
    "a folder": folder,
    "without a column": rewritten(lambda table: table.drop_columns(["digest"])),
    "of another type": rewritten(other_type),
    "with nulls": rewritten(null_ids),
    "with a column twice": rewritten(twice),
    "not UTF-8": rewritten(no_utf8),
}


@pytest.mark.parametrize("spoil", UNREADABLE.values(), ids=UNREADABLE)
def test_a_catalog_that_cannot_be_read_is_built_in_memory(root: Path, spoil: Any) -> None:
    wanted = rebuilt(root)
    spoil(root)
    assert read_catalog(root) is None
    assert opened_with_warning(root, "missing").catalog.equals(wanted)


def test_any_flipped_byte_is_found_or_harmless(root: Path) -> None:
    path = root / CATALOG_NAME
    content = path.read_bytes()
    wanted = read_catalog(root)
    generator = np.random.default_rng(3)
    unreadable = 0
    for position in generator.integers(0, len(content), 150):
        changed = bytearray(content)
        changed[position] ^= int(generator.integers(1, 256))
        path.write_bytes(changed)
        table = read_catalog(root)
        if table is None:
            unreadable += 1
        elif position < 4000:  # where the data pages are: their checksums were looked at
            assert table.equals(wanted)
    assert unreadable > 50


def test_other_columns_are_kept(root: Path) -> None:
    rewritten(lambda table: table.append_column("mine", pa.array([1, 2, 3])))(root)
    assert opened(root).catalog.column("mine").to_pylist() == [1, 2, 3]


# -------------------------------------------------------------------------------------------- stale


def test_an_episode_that_came_is_added(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_small(root / episode_path(episode_id(7)), 7)
    wanted = rebuilt(root)
    read: list[str] = []

    def counted(*args: Any, **options: Any) -> Any:
        read.extend(options["paths"])
        return build_catalog(*args, **options)

    monkeypatch.setattr("exumi_data.catalog.build_catalog", counted)
    dataset = opened_with_warning(root, "stale")
    assert dataset.catalog.equals(wanted)
    assert read == [episode_path(episode_id(7))]  # the others were not read again
    assert dataset[episode_id(7)].id == episode_id(7)


def test_an_episode_that_went_is_left_out(root: Path) -> None:
    shutil.rmtree(root / episode_path(IDS[1]))
    dataset = opened_with_warning(root, "stale")
    assert dataset.ids == [IDS[0], IDS[2]]
    assert dataset.catalog.equals(rebuilt(root))


def test_an_episode_that_was_packed_is_found(root: Path) -> None:
    folder = root / episode_path(IDS[0])
    packed = pack(folder)
    shutil.rmtree(folder)
    dataset = opened_with_warning(root, "stale")
    assert sorted(dataset.ids) == sorted(IDS)
    assert dataset[IDS[0]].path == str(packed)


def test_an_episode_that_changed_is_said_to_have(root: Path) -> None:
    edit_metadata(root / episode_path(IDS[1]), lambda document: document.update(revision=2))
    dataset = opened(root)
    assert dataset[0].metadata.revision == 1
    with pytest.warns(CatalogWarning, match="the episode changed after the catalog was written"):
        assert dataset[1].metadata.revision == 2


def test_an_episode_that_became_another_is_refused(root: Path) -> None:
    shutil.rmtree(root / episode_path(IDS[0]))
    write_small(root / episode_path(IDS[0]), 9)
    with pytest.raises(DamagedDataError, match=f"the catalog says {IDS[0]}, the episode says"):
        _ = opened(root)[0]


def test_rows_that_come_twice_are_not_believed(root: Path) -> None:
    rewritten(lambda table: pa.concat_tables([table, table]))(root)
    assert opened_with_warning(root, "stale").ids == IDS


def test_a_path_that_leads_out_is_not_followed(root: Path, tmp_path: Path) -> None:
    write_small(tmp_path / "secret.zarr")

    def lead_out(table: pa.Table) -> pa.Table:
        paths = ["../secret.zarr", *table.column("path").to_pylist()[1:]]
        return table.set_column(1, catalog_schema().field("path"), pa.array(paths))

    rewritten(lead_out)(root)
    assert opened_with_warning(root, "stale").ids == IDS
    table = pq.ParquetFile(root / CATALOG_NAME).read()
    dataset = Dataset(str(root), opened_with_warning(root, "stale").metadata, table)
    with pytest.raises(DamagedDataError, match="unsafe path"):
        _ = dataset[0]


@pytest.mark.parametrize("catalog", [True, False])
def test_two_episodes_with_the_same_id(root: Path, catalog: bool) -> None:
    pack(root / episode_path(IDS[0]))
    if catalog:
        write_catalog(root, rebuilt(root))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CatalogWarning)
        with pytest.raises(DamagedDataError, match="are the same episode") as caught:
            opened(root)
    assert f"{episode_path(IDS[0])} and {episode_path(IDS[0])}.zip" in str(caught.value)


def test_what_is_half_written_or_put_aside_is_no_episode(root: Path) -> None:
    shelf = (root / episode_path(IDS[0])).parent
    for name in (
        f".partial-{episode_id(5)}",
        f".replaced-{episode_id(5)}.zarr",
        ".partial-1-a.zarr.zip",
    ):
        shutil.copytree(root / episode_path(IDS[0]), shelf / name)
    for name in ("notes.txt", "a.zip", "b.zarr.zip.part"):
        (shelf / name).write_text("x")
    (root / "episodes" / ".hidden").mkdir()
    (root / "episodes" / "file").write_text("x")
    assert list_episodes(root) == [episode_path(episode_id) for episode_id in IDS]
    assert opened(root).ids == IDS


def test_episodes_that_cannot_be_read_are_counted(root: Path) -> None:
    for episode in IDS[:2]:
        (root / episode_path(episode) / "zarr.json").unlink()
    remove(root)
    message = r"2 episode\(s\) cannot be read; the first: .*exumi validate"
    with pytest.warns(CatalogWarning), pytest.raises(DamagedDataError, match=message):
        exumi_data.open(root)
    table, failed = build_catalog(root)
    assert table.column("id").to_pylist() == [IDS[2]]
    assert sorted(outcome.item for outcome in failed) == [episode_path(i) for i in IDS[:2]]
    assert all(isinstance(outcome.error, ExumiError) for outcome in failed)


def test_an_empty_dataset(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "ds", 0)
    assert list_episodes(root) == []
    assert len(opened(root)) == 0
    shutil.rmtree(root / "episodes")
    assert opened(root).ids == []


def test_the_paths_of_episodes() -> None:
    assert episode_path("0190a1b2-0000-7000-8000-0000000000ab") == (
        "episodes/ab/0190a1b2-0000-7000-8000-0000000000ab.zarr"
    )
    assert episode_path("0190a1b2-0000-7000-8000-0000000000ab", packed=True).endswith(".zarr.zip")


# ------------------------------------------------------------------------------------- fingerprints


def test_the_fingerprint_changes_with_any_episode(root: Path) -> None:
    seen = {fingerprint(rebuilt(root)), opened(root).fingerprint}
    assert len(seen) == 1
    derived = root / episode_path(IDS[0]) / "derived" / "zarr.json"
    edit_json(derived, lambda document: document["attributes"]["exumi"].update({"acme:x": 1}))
    seen.add(fingerprint(rebuilt(root)))
    width = root / episode_path(IDS[1]) / "streams" / "width" / "zarr.json"
    width.write_bytes(width.read_bytes() + b" ")
    seen.add(fingerprint(rebuilt(root)))
    shutil.rmtree(root / episode_path(IDS[2]))
    seen.add(fingerprint(rebuilt(root)))
    assert len(seen) == 4


# --------------------------------------------------------------------------------------------- size


def test_many_rows_are_taken_from_the_catalog_alone(root: Path) -> None:
    (row,) = rebuilt(root).slice(0, 1).to_pylist()
    rows = []
    for number in range(5000):
        identity = episode_id(number)
        path = episode_path(identity)
        rows.append({**row, "id": identity, "path": path})
        (root / path).mkdir(parents=True, exist_ok=True)  # whoever opened them would find nothing
    write_catalog(root, rows_to_table(rows))
    dataset = opened(root)
    assert len(dataset) == 5000
    assert dataset.episode_location(4999) == f"{root}/{max(row['path'] for row in rows)}"
