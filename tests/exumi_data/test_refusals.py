"""What is too new is refused: what it is, and what to do about it (DOC-005, ROOT-003)."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import exumi_data
from exumi_data.cli.app import app
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import UnsupportedError
from exumi_data.model import SplitDocument
from exumi_data.model.base import Model
from exumi_data.model.documents import dump
from exumi_data.store.pack import pack
from tests.exumi_data.builders import (
    edit_json,
    edit_metadata,
    episode_id,
    write_dataset,
    write_small,
)

NEWER_MAJOR = {"version": "2.1"}
UNKNOWN_FEATURE = {"version": "1.3", "requires": ["holograms"]}
Change = dict[str, Any]


def folder(root: Path, change: Change) -> Path:
    path = write_small(root / "a.zarr")
    edit_metadata(path, lambda document: document.update(change))
    return path


def packed(root: Path, change: Change) -> Path:
    return pack(folder(root, change))


def dataset(root: Path, change: Change) -> Path:
    write_dataset(root / "ds", 1)
    edit_json(root / "ds" / "dataset.json", lambda document: document.update(change))
    return root / "ds"


def split(root: Path, change: Change) -> Path:
    write_dataset(root / "ds", 1, splits=["own"])
    own = SplitDocument(name="own", level="episode", lists={"train": [episode_id(0)]})
    (root / "ds" / "splits").mkdir()
    (root / "ds" / "splits" / "own.json").write_text(json.dumps({**dump(own), **change}))
    return root / "ds"


def derived(root: Path, change: Change) -> Path:
    path = write_small(root / "a.zarr")
    edit_metadata(path / "derived", lambda document: document.update(change))
    return path


def read(path: Path) -> list[Model]:
    """Read every document of what is there."""
    opened = exumi_data.open(path)
    if isinstance(opened, Dataset):
        return [opened.metadata, *opened.splits.values()]
    assert isinstance(opened, Episode)
    assert opened.derived is not None
    return [opened.metadata, opened.derived]


PLACES: list[Callable[[Path, Change], Path]] = [folder, packed, dataset, split, derived]


@pytest.mark.parametrize("make", PLACES, ids=lambda make: make.__name__)
def test_a_newer_major_is_refused_with_its_version_and_what_to_install(
    tmp_path: Path, make: Callable[[Path, Change], Path]
) -> None:
    path = make(tmp_path, NEWER_MAJOR)
    with pytest.raises(UnsupportedError) as caught:
        read(path)
    message = str(caught.value)
    assert "version 2.1 is newer than this library, which reads up to 1.x" in message
    assert 'pip install -U "exumi-data"' in message
    assert str(path) in message
    assert "\n" not in message


@pytest.mark.parametrize("make", PLACES, ids=lambda make: make.__name__)
def test_an_unknown_feature_is_refused_by_its_name(
    tmp_path: Path, make: Callable[[Path, Change], Path]
) -> None:
    path = make(tmp_path, UNKNOWN_FEATURE)
    with pytest.raises(UnsupportedError) as caught:
        read(path)
    message = str(caught.value)
    assert "requires holograms, which this library does not know (format version 1.3)" in message
    assert 'pip install -U "exumi-data"' in message
    assert str(path) in message


@pytest.mark.parametrize("make", PLACES, ids=lambda make: make.__name__)
def test_a_newer_minor_is_read(tmp_path: Path, make: Callable[[Path, Change], Path]) -> None:
    documents = read(make(tmp_path, {"version": "1.3", "requires": [], "weather": "rain"}))
    (newer,) = [dump(one) for one in documents if "weather" in dump(one)]
    assert newer["version"] == "1.3"
    assert newer["weather"] == "rain"


@pytest.mark.parametrize("change", [NEWER_MAJOR, UNKNOWN_FEATURE], ids=["major", "feature"])
@pytest.mark.parametrize("verb", ["info", "pack"])
def test_the_command_line_says_the_same_in_one_line(
    tmp_path: Path, change: Change, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        app([verb, str(folder(tmp_path, change))])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert str(change.get("requires", ["2.1"])[0]) in said
    assert "pip install -U" in said
