"""A dataset as users hold it: like a list, and like a table."""

import copy
from pathlib import Path

import pyarrow.compute as pc
import pytest

import exumi_data
from exumi_data import Dataset
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.errors import DamagedDataError, MetadataError, NotAnEpisodeError, UsageError
from exumi_data.model import Annotations, DatasetMetadata
from tests.exumi_data.builders import (
    edit_json,
    episode_id,
    write_dataset,
    write_episode,
    write_small,
)

SPLIT = """{"format": "exumi-split", "version": "1.0", "name": "parts", "level": "part",
"lists": {"train": ["%s"], "test": []}}"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four episodes: parts a, a, b and none; the last one has every stream."""
    root = tmp_path_factory.mktemp("dataset") / "ds"
    create_dataset(root, DatasetMetadata(name="tests", licence="CC0-1.0", splits=["parts"]))
    (root / "splits").mkdir()
    (root / "splits" / "parts.json").write_text(SPLIT % episode_id(0))
    for number, part in enumerate(("a", "a", "b")):
        path = root / episode_path(episode_id(number))
        write_small(path, number, annotations=Annotations(part_id=part), success=number == 0)
    write_episode(root / episode_path(episode_id(3)), 3)
    table, failed = build_catalog(root)
    assert not failed
    write_catalog(root, table)
    return root


@pytest.fixture
def dataset(root: Path) -> Dataset:
    return open_dataset(root)


def test_it_is_like_a_list_of_episodes(dataset: Dataset) -> None:
    assert len(dataset) == 4
    assert dataset.ids == sorted(map(episode_id, range(4)), key=episode_path)
    assert [episode.id for episode in dataset] == dataset.ids
    for index, identity in enumerate(dataset.ids):
        assert dataset[index].id == dataset[index - 4].id == dataset[identity].id == identity
        assert identity in dataset
    assert "nothing" not in dataset
    for index in (4, -5):
        with pytest.raises(IndexError, match=f"episode {index} of 4"):
            _ = dataset[index]
    with pytest.raises(UsageError, match="no episode 'nothing'"):
        _ = dataset["nothing"]
    assert repr(dataset) == "<Dataset 'tests', 4 episodes>"


def test_a_slice_is_a_dataset(dataset: Dataset) -> None:
    assert dataset[1:3].ids == dataset.ids[1:3]
    assert dataset[::-2].ids == dataset.ids[::-2]
    assert dataset[9:].ids == []
    assert dataset[1:3][1].id == dataset.ids[2]
    assert dataset[1:3].fingerprint != dataset.fingerprint


def test_selections(dataset: Dataset) -> None:
    numbered = [episode_id(number) for number in range(4)]

    def found(selection: Dataset) -> set[int]:
        return {numbered.index(identity) for identity in selection.ids}

    assert dataset.select([numbered[2], numbered[0]]).ids == [numbered[2], numbered[0]]
    assert dataset.select([]).ids == []
    assert found(dataset.select(part_id="a")) == {0, 1}
    assert found(dataset.select(part_id=["a", "b"])) == {0, 1, 2}
    assert found(dataset.select(part_id=None)) == {3}
    assert found(dataset.select(part_id="a", success=True)) == {0}
    assert found(dataset.select(kind="pose")) == {3}
    assert found(dataset.select(stream={"rgb", "gopro"})) == {3}
    assert found(dataset.select(kind="tactile")) == {0, 1, 2, 3}
    assert found(dataset.select(where=pc.field("duration_s") > 0.42)) == {3}
    assert found(dataset.select(part_id="none of them")) == set()
    assert len(dataset.select(part_id="x").select(kind="rgb")) == 0
    assert len(dataset) == 4  # it is a view
    with pytest.raises(UsageError, match=r"no column 'colour'.*It has: id, path"):
        dataset.select(colour="red")
    with pytest.raises(UsageError, match="no episode 'x'"):
        dataset.select([numbered[0], "x"])


def test_splits_are_read_by_name(dataset: Dataset) -> None:
    assert dict(dataset.splits["parts"].lists) == {"train": [episode_id(0)], "test": []}
    assert dataset.select(dataset.splits["parts"].lists["train"]).ids == [episode_id(0)]


def test_a_missing_split_is_named(tmp_path: Path) -> None:
    dataset = open_dataset(write_dataset(tmp_path / "ds", 1, splits=["random"]))
    with pytest.raises(DamagedDataError, match="names a split 'random' that is not there"):
        _ = dataset.splits
    (tmp_path / "ds" / "splits").mkdir()
    (tmp_path / "ds" / "splits" / "random.json").write_text("{}")
    with pytest.raises(MetadataError, match=r"random\.json"):
        _ = dataset.splits


@pytest.mark.parametrize("name", ["../evil", "a/b", "", "A", "a.json"])
def test_the_name_of_a_split_cannot_lead_elsewhere(tmp_path: Path, name: str) -> None:
    root = write_dataset(tmp_path / "ds", 0)
    edit_json(root / "dataset.json", lambda document: document.update(splits=[name]))
    with pytest.raises(MetadataError, match=r"\$\.splits\[0\]"):
        open_dataset(root)


def test_a_dataset_can_be_sent_to_another_process(dataset: Dataset) -> None:
    other = copy.copy(dataset[1:])
    assert other.ids == dataset.ids[1:]
    assert other[0].id == dataset.ids[1]


def test_making_a_dataset(tmp_path: Path) -> None:
    metadata = DatasetMetadata(name="tests", licence="CC0-1.0")
    metadata.authors.append("Somebody")
    root = create_dataset(tmp_path / "a" / "ds", metadata)
    assert open_dataset(root).metadata == metadata
    assert open_dataset(root).metadata.authors == ["Somebody"]
    assert create_dataset(root, metadata) == root
    (tmp_path / "empty").mkdir()
    assert isinstance(exumi_data.open(create_dataset(tmp_path / "empty", metadata)), Dataset)


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path) -> None:
    metadata = DatasetMetadata(name="tests", licence="CC0-1.0")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "me.jpg").write_bytes(b"x")
    (tmp_path / "file").write_bytes(b"x")
    for path in (tmp_path / "photos", tmp_path / "file"):
        with pytest.raises(UsageError, match="is no exUMI dataset"):
            create_dataset(path, metadata)
        with pytest.raises(NotAnEpisodeError):
            open_dataset(path)
    assert [path.name for path in (tmp_path / "photos").iterdir()] == ["me.jpg"]
