import json
import logging
import re
from pathlib import Path
from typing import Any

import pytest

from exumi_data.catalog import CATALOG_NAME, build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.editing.documents import write_splits
from exumi_data.errors import UsageError
from exumi_data.model import Annotations, DatasetMetadata, Label, LossyStep, Source
from exumi_data.model.dataset import SplitDocument
from exumi_data.release.citation import Edition
from exumi_data.release.croissant import CROISSANT_NAME, croissant_of
from tests.exumi_data.builders import episode_id, write_dataset, write_small

# Libraries that mlcroissant is made with warn of each other; its own warnings are logged.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

EDITION = Edition(version="1.2.0", published="2026-03-01")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("croissant") / "set"
    create_dataset(
        root, DatasetMetadata(name="touches", licence="CC-BY-4.0", authors=["A. Person"])
    )
    labels = [
        Label(property="hardness", value=3.5, scale=[0, 10], raters=3, provenance="human"),
        Label(property="material", value=["wood", "felt"], provenance="model"),
    ]
    source = Source(
        type="simulated",
        tool="tests",
        tool_version="1",
        lossy=[LossyStep(step="jpeg-encode", stream="tactile", detail="quality 95")],
    )
    said: list[dict[str, Any]] = [
        {"annotations": Annotations(object_id="cup", trial=2, labels=labels), "success": True},
        {"source": source, "start": "2026-01-02T03:04:05.123456789Z"},
        {"success": False},
    ]
    for number, changes in enumerate(said):
        write_small(root / episode_path(episode_id(number)), number, **changes)
    write_catalog(root, build_catalog(root)[0])
    lists = {"train": [episode_id(0), episode_id(2)], "held out": [episode_id(1)], "none": []}
    write_splits(root, {"default": SplitDocument(name="default", level="episode", lists=lists)})
    return root


def load(root: Path, document: dict[str, Any], caplog: pytest.LogCaptureFixture) -> Any:
    """Load the description as anybody would; whatever it warns of is an error."""
    mlcroissant = pytest.importorskip("mlcroissant")
    path = root / CROISSANT_NAME
    path.write_text(json.dumps(document), "utf-8")
    with caplog.at_level(logging.WARNING):
        return mlcroissant.Dataset(str(path))


def records(loaded: Any, name: str) -> list[dict[str, Any]]:
    return [plain(record) for record in loaded.records(name)]


def plain(value: Any) -> Any:
    """The record without the names of its set, and with Python's own types."""
    if isinstance(value, dict):
        return {key.rpartition("/")[2]: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, bytes):
        return value.decode()
    return value.item() if hasattr(value, "item") else value


def test_that_its_records_are_the_catalog(dataset: Path, caplog: pytest.LogCaptureFixture) -> None:
    document = croissant_of(dataset, edition=EDITION)
    loaded = load(dataset, document, caplog)
    assert loaded.metadata.ctx.issues.report() == ""
    assert caplog.text == ""
    assert records(loaded, "episodes") == open_dataset(dataset).catalog.to_pylist()
    assert loaded.metadata.version == "1.2.0"
    assert loaded.metadata.license == ["https://spdx.org/licenses/CC-BY-4.0.html"]


def test_that_its_splits_are_those_of_the_dataset(
    dataset: Path, caplog: pytest.LogCaptureFixture
) -> None:
    document = croissant_of(dataset, edition=EDITION)
    loaded = load(dataset, document, caplog)
    rows = records(loaded, "splits")
    assert {row["name"]: row["episodes"] for row in rows} == {
        "default/train": 2,
        "default/held out": 1,
        "default/none": 0,
    }
    lists = open_dataset(dataset).splits["default"].lists
    # What Croissant has no word for is null, which pandas makes NaN of.
    urls = {row["name"]: row["url"] for row in rows if isinstance(row["url"], str)}
    assert urls == {"default/train": "cr:TrainingSplit"}
    for row in rows:
        found = records(loaded, row["record_set"])
        assert [record["id"] for record in found] == lists[row["name"].partition("/")[2]]


def test_that_it_says_how_the_data_came_about(dataset: Path) -> None:
    document = croissant_of(dataset)
    assert document["rai:dataPreprocessingProtocol"] == ["jpeg-encode of tactile: quality 95"]
    assert document["rai:dataAnnotationProtocol"] == [
        "hardness: by people, from 0 to 10, 3 raters a value",
        "material: by a model",
    ]
    assert document["rai:dataCollectionTimeFrame"] == ["2026-01-02T03:04:05.123456789Z"] * 2


def test_that_nothing_is_made_up_and_the_clock_is_not_asked(dataset: Path) -> None:
    document = croissant_of(dataset)
    assert not {"version", "datePublished", "url"} & set(document)
    assert json.dumps(document) == json.dumps(croissant_of(dataset))
    assert str(dataset) not in json.dumps(document)


def test_the_description_of_a_changed_catalog_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    root = write_dataset(tmp_path / "set", 1)
    document = croissant_of(root, edition=EDITION)
    with (root / CATALOG_NAME).open("ab") as file:
        file.write(b"\0")
    (root / CROISSANT_NAME).write_text(json.dumps(document), "utf-8")
    loaded = load(root, document, caplog)
    with pytest.raises(mlcroissant.GenerationError, match="Download") as caught:
        list(loaded.records("episodes"))
    assert "Hash of downloaded file" in str(caught.value.__cause__)


def test_a_dataset_elsewhere(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 1)
    document = croissant_of(root, "https://data.example/set/")
    urls = [file["contentUrl"] for file in document["distribution"] if "contentUrl" in file]
    assert urls == [
        "https://data.example/set/catalog.parquet",
        "https://data.example/set/dataset.json",
    ]


def test_a_dataset_without_a_catalog(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 1)
    (root / CATALOG_NAME).rename(root / "elsewhere")
    with pytest.warns(match="missing"), pytest.raises(UsageError, match="exumi index"):
        croissant_of(root)


def test_real_clips(real_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    from exumi_converters import ConvertOptions, convert

    root = tmp_path / "clips"
    shots = tmp_path / "clips-in"
    shots.mkdir()
    for path in sorted((real_data / "physiclear" / "videos").glob("*.mov"))[:2]:
        (shots / path.name).symlink_to(path)
    convert(shots, root, from_format="clips", options=ConvertOptions(licence="NOASSERTION"))
    document = croissant_of(root, edition=EDITION)
    loaded = load(root, document, caplog)
    assert caplog.text == ""
    assert records(loaded, "episodes") == open_dataset(root).catalog.to_pylist()
    assert re.search("video-encode", json.dumps(document))
