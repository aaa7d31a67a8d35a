"""Keys that we do not know stay where they are, whatever rewrites a document (META-004)."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import exumi_data
from exumi_converters import prepare
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.cli.app import app
from exumi_data.dataset import Dataset, create_dataset
from exumi_data.episode import open_episode
from exumi_data.model import (
    Annotations,
    CalibrationItem,
    DatasetMetadata,
    Label,
    Sensor,
    SplitDocument,
)
from exumi_data.model.documents import dump
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack
from exumi_validators import validate
from tests.exumi_data.builders import (
    add_images,
    add_low_dimensional,
    encoded_images,
    episode_id,
    jpegs,
    metadata,
    times,
)

VENDOR = {"acme:rig": {"table": 3}, "acme:note": "keep me"}
NEWER = {"weather": {"rain": False}, "acme:note": "keep me"}
ID = episode_id(0)

# Where keys are planted: in objects of all sorts, also those that a resize writes anew.
EPISODE_PLACES = (
    (),
    ("task",),
    ("streams", "tactile"),
    ("streams", "tactile", "clock"),
    ("streams", "tactile", "images"),
    ("streams", "tactile", "reference"),
    ("streams", "tactile", "sensor"),
    ("streams", "gopro"),
    ("streams", "pose"),
    ("streams", "pose", "frames"),
    ("streams", "smell"),
    ("annotations",),
    ("annotations", "labels", 0),
)
DERIVED_PLACES = ((), ("items", "tactile/activity"))
DOCUMENT_PLACES = ((), ("made_by",))


def at(document: Any, place: tuple[Any, ...]) -> Any:
    for part in place:
        document = document[part]
    return document


def exumi(path: Path) -> Any:
    document = json.loads(path.read_bytes())
    return document["attributes"]["exumi"] if path.name == "zarr.json" else document


def plant(path: Path, places: tuple[tuple[Any, ...], ...], keys: dict[str, Any]) -> None:
    """Put keys into a document as another tool would: the file is written, nothing else."""
    document = json.loads(path.read_bytes())
    inner = document["attributes"]["exumi"] if path.name == "zarr.json" else document
    if keys is NEWER:
        inner["version"] = "1.9"
    for place in places:
        at(inner, place).update(keys)
    path.write_text(json.dumps(document), "utf-8")


def kept(path: Path, places: tuple[tuple[Any, ...], ...], keys: dict[str, Any]) -> bool:
    document = exumi(path)
    assert document["version"] == ("1.9" if keys is NEWER else "1.0")
    for place in places:
        found = at(document, place)
        assert {key: found.get(key) for key in keys} == keys, place
    return True


def write_rich(path: Path) -> None:
    """An episode with everything, in which tactile has a sensor."""
    notes = Annotations(labels=[Label(property="hardness", value="soft", provenance="human")])
    item = CalibrationItem(value={"m_per_count": 0.015, "zero_m": 0.02}, method="made up")
    about = metadata(0, annotations=notes, calibration={"encoder": item})
    with EpisodeWriter(path, about, durable=False) as writer:
        add_low_dimensional(writer)
        add_images(writer)
        writer._streams["tactile"].model.sensor = Sensor(model="gelsight-mini")


@pytest.fixture(params=[VENDOR, NEWER], ids=["vendor", "newer"])
def keys(request: pytest.FixtureRequest) -> dict[str, Any]:
    """The keys that are planted."""
    found: dict[str, Any] = request.param
    return found


@pytest.fixture
def dataset(tmp_path: Path, keys: dict[str, Any]) -> Path:
    """A dataset in whose documents unknown keys stand everywhere."""
    root = tmp_path / "source"
    made_by: Any = {"tool": "other", "tool_version": "1"}
    create_dataset(
        root, DatasetMetadata(name="source", licence="CC0-1.0", splits=["own"], made_by=made_by)
    )
    path = root / episode_path(ID)
    write_rich(path)
    plant(path / "zarr.json", EPISODE_PLACES, keys)
    plant(path / "derived" / "zarr.json", DERIVED_PLACES, keys)
    (root / "splits").mkdir()
    split = SplitDocument(name="own", level="episode", lists={"train": [ID]})
    (root / "splits" / "own.json").write_text(json.dumps(dump(split)))
    plant(root / "splits" / "own.json", ((),), keys)
    plant(root / "dataset.json", DOCUMENT_PLACES, keys)
    table, _ = build_catalog(root)
    write_catalog(root, table)
    return root


def folder_of(root: Path) -> Path:
    """The only episode of a dataset."""
    (path,) = root.glob("episodes/*/*.zarr")
    return path


def bytes_below(root: Path) -> dict[str, bytes]:
    files = (path for path in root.rglob("*") if path.is_file() and path.suffix != ".parquet")
    return {str(path.relative_to(root)): path.read_bytes() for path in files}


def all_kept(root: Path, keys: dict[str, Any]) -> None:
    folder = folder_of(root)
    assert kept(folder / "zarr.json", EPISODE_PLACES, keys)
    assert kept(folder / "derived" / "zarr.json", DERIVED_PLACES, keys)
    assert kept(root / "splits" / "own.json", ((),), keys)
    assert kept(root / "dataset.json", ((),), keys)
    assert {p.code for p in validate(root).problems if p.severity == "error"} == set()


def test_reading_keeps_them_in_the_models(dataset: Path, keys: dict[str, Any]) -> None:
    opened = exumi_data.open(dataset)
    assert isinstance(opened, Dataset)
    models = [opened.metadata, opened.splits["own"], opened[0].metadata, opened[0].derived]
    for model in models:
        assert model is not None
        document = dump(model)
        assert {key: document[key] for key in keys} == keys


def test_packing_copies_every_byte(dataset: Path, keys: dict[str, Any]) -> None:
    folder = folder_of(dataset)
    target = pack(folder)
    with open_episode(target) as episode:
        for path, content in bytes_below(folder).items():
            assert episode.store.read(path) == content
        document = dump(episode.metadata)
        for place in EPISODE_PLACES:
            found = at(document, place)
            assert {key: found[key] for key in keys} == keys


def test_indexing_touches_no_document(dataset: Path) -> None:
    before = bytes_below(dataset)
    (dataset / "catalog.parquet").unlink()
    with pytest.raises(SystemExit) as ended:
        app(["index", str(dataset), "--quiet"])
    assert ended.value.code == 0
    assert (dataset / "catalog.parquet").is_file()
    assert bytes_below(dataset) == before


@pytest.mark.parametrize("options", [{"size": 16}, {"size": 16, "lossless": True}])
def test_preparing_carries_them_along(
    dataset: Path, keys: dict[str, Any], options: dict[str, Any], tmp_path: Path
) -> None:
    report = prepare(dataset, tmp_path / "made", workers=1, **options)
    assert report.failed == ()
    all_kept(tmp_path / "made", keys)


def test_preparing_again_keeps_what_was_added_to_the_result(
    dataset: Path, keys: dict[str, Any], tmp_path: Path
) -> None:
    made = tmp_path / "made"
    prepare(dataset, made, size=16, workers=1)
    added = {"other:label": 7}
    for document in (made / "dataset.json", made / "splits" / "own.json"):
        content = json.loads(document.read_bytes())
        document.write_text(json.dumps({**content, **added}))
    # Something changed in the source, so that its split is written anew.
    split = json.loads((dataset / "splits" / "own.json").read_bytes())
    split["lists"] = {"val": [ID]}
    (dataset / "splits" / "own.json").write_text(json.dumps(split))
    prepare(dataset, made, size=16, workers=1)
    lists = exumi(made / "splits" / "own.json")["lists"]
    assert [name for name, ids in lists.items() if ids] == ["val"]
    all_kept(made, keys)
    for document in (made / "dataset.json", made / "splits" / "own.json"):
        assert exumi(document)["other:label"] == 7


def test_a_copied_stream_keeps_them(dataset: Path, keys: dict[str, Any], tmp_path: Path) -> None:
    with open_episode(folder_of(dataset)) as parent:
        own = parent.metadata.model_copy(deep=True)
        own.streams = {}
        with EpisodeWriter(tmp_path / "copy.zarr", own, durable=False) as writer:
            for name in parent:
                writer.copy_stream(parent, name)
    assert kept(tmp_path / "copy.zarr" / "zarr.json", EPISODE_PLACES, keys)


def test_an_array_of_a_newer_version_beside_frames_stops_a_resize(
    tmp_path: Path, make_exposure: Path
) -> None:
    report = prepare(make_exposure, tmp_path / "made", size=16, workers=1)
    (failure,) = report.failed
    assert "exposure" in failure.reason
    assert "upgrade" in failure.reason.lower()


@pytest.fixture
def make_exposure(tmp_path: Path) -> Path:
    """An episode of version 1.9 with an array beside its frames that 1.0 does not know."""
    path = tmp_path / "newer.zarr"
    with EpisodeWriter(path, metadata(0), durable=False) as writer:
        stream = writer.add_stream("rgb", kind="rgb", images=encoded_images())
        stream.append(times(), jpegs())
    folder = path / "streams" / "rgb"
    shutil.copytree(folder / "crc32c", folder / "exposure")
    plant(path / "zarr.json", (), NEWER)
    document = json.loads((path / "zarr.json").read_bytes())
    document["attributes"]["exumi"]["streams"]["rgb"]["arrays"].append("exposure")
    (path / "zarr.json").write_text(json.dumps(document))
    with open_episode(path) as episode:
        assert len(episode["rgb"].array("exposure")) == len(times())
    return path
