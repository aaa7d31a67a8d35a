"""Episodes are chosen, copied, merged and removed; what is left is always a valid dataset."""

import json
import shutil
from itertools import chain
from pathlib import Path

import pytest

from exumi_data.catalog import list_episodes
from exumi_data.cli.indexing import refresh_catalog
from exumi_data.dataset import Dataset, open_dataset
from exumi_data.editing import copying
from exumi_data.editing.copying import chosen_of, copy_episodes
from exumi_data.editing.documents import write_splits
from exumi_data.editing.merging import join_splits, plan_merge
from exumi_data.editing.removal import TOMBSTONE, remove_episodes
from exumi_data.editing.revising import revise
from exumi_data.editing.selection import choose
from exumi_data.errors import UsageError
from exumi_data.leftovers import clean_leftovers
from exumi_data.model import EpisodeMetadata
from exumi_data.model.dataset import SplitDocument
from exumi_data.model.description import Annotations
from exumi_data.splits import make_split
from exumi_data.store.pack import pack
from exumi_data.store.stream_copy import copy_file
from exumi_validators import validate
from tests.exumi_data.builders import episode_id, write_dataset

IDS = [episode_id(number) for number in range(3)]


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return open_dataset(write_dataset(tmp_path / "set"))


def succeed(found: EpisodeMetadata) -> None:
    found.success = True


def touch_a_mug(found: EpisodeMetadata) -> None:
    found.annotations = Annotations(object_id="mug")


def refreshed(dataset: Dataset | Path) -> Dataset:
    """Open a dataset with its catalog written anew, as commands leave it."""
    root = dataset if isinstance(dataset, Path) else Path(dataset.path)
    refresh_catalog(root)
    return open_dataset(root)


def problems_of(path: Path | str) -> list[str]:
    found = validate(path).problems
    return [f"{one.code} {one.location.path}" for one in found if one.severity == "error"]


def test_conditions(dataset: Dataset) -> None:
    revise(Path(dataset.episode_location(0)), succeed)
    dataset = refreshed(dataset)
    (good,) = choose(dataset, where=["success=true"])
    assert set(choose(dataset, where=["success!=true"])) == set(IDS) - {good}
    assert set(choose(dataset, where=["success="])) == set(IDS) - {good}
    assert choose(dataset, where=["revision>=2"]) == [good]
    assert choose(dataset, where=["trial<3"]) == []  # what is not known is not less
    assert choose(dataset, where=["task=push|press", "kind=tactile"]) == dataset.ids
    assert choose(dataset, where=["kind!=tactile"]) == []
    assert choose(dataset, ids=[good[:8], good[-8:]]) == [good]
    assert choose(dataset, everything=True) == dataset.ids


@pytest.mark.parametrize(
    ("condition", "says"),
    [
        ("press", "COLUMN=VALUE"),
        ("colour=red", "no column 'colour'"),
        ("revision=two", "int64"),
        ("success=maybe", "bool"),
        ("kind<tactile", "is or is not there"),
    ],
)
def test_what_is_no_condition(dataset: Dataset, condition: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        choose(dataset, where=[condition])


def test_who_says_nothing_means_nothing(dataset: Dataset) -> None:
    with pytest.raises(UsageError, match="which episodes"):
        choose(dataset)
    with pytest.raises(UsageError, match=r"no episode 'beef00'; no episode 'zz'"):
        choose(dataset, ids=["beef00", "zz"])
    with pytest.raises(UsageError, match="default/val"):
        choose(dataset, split="train")


def into(chosen: list[copying.Chosen], root: Path) -> Path:
    write_dataset(root, 0)
    copy_episodes(chosen, root)
    refreshed(root)
    return root


def test_copies_are_the_same_bytes_in_the_same_form(dataset: Dataset, tmp_path: Path) -> None:
    folder = Path(dataset.episode_location(1))
    pack(folder)
    shutil.rmtree(folder)
    dataset = refreshed(dataset)
    copy = into(chosen_of(dataset, dataset.ids[:2]), tmp_path / "copy")
    assert problems_of(copy) == []
    for path in list_episodes(copy):
        theirs, ours = Path(dataset.path) / path, copy / path
        files = [ours] if ours.is_file() else [one for one in ours.rglob("*") if one.is_file()]
        assert files
        for one in files:
            assert one.read_bytes() == (theirs / one.relative_to(ours)).read_bytes()
    assert sorted(path.endswith(".zip") for path in list_episodes(copy)) == [False, True]


def test_a_copy_that_fails_leaves_no_episode(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = write_dataset(tmp_path / "copy", 0)
    real, count = copy_file, [0]

    def fail(*arguments: object) -> None:
        count[0] += 1
        if count[0] == 30:
            raise OSError(28, "No space left on device")
        real(*arguments)  # type: ignore[arg-type]  # passed on as they are

    monkeypatch.setattr(copying, "copy_file", fail)
    with pytest.raises(OSError, match="No space"):
        copy_episodes(chosen_of(dataset), copy)
    there = list_episodes(copy)
    monkeypatch.undo()
    clean_leftovers(copy)
    assert len(there) < 3
    inodes = {path: (copy / path).stat().st_ino for path in there}
    copy_episodes(chosen_of(dataset), copy)
    assert problems_of(refreshed(copy).path) == []
    # What was whole already was not copied again.
    assert {path: (copy / path).stat().st_ino for path in there} == inodes


def test_a_merge_takes_an_episode_once_in_its_latest_revision(
    dataset: Dataset, tmp_path: Path
) -> None:
    other = Path(shutil.copytree(dataset.path, tmp_path / "other"))
    revise(next(other.glob(f"episodes/*/{IDS[1]}.zarr")), succeed)
    later = refreshed(other)
    merge = plan_merge([dataset, later])
    assert sorted(one.id for one in merge.chosen) == sorted(IDS)
    assert {one.id: one.root for one in merge.chosen}[IDS[1]] == other
    assert [notice.split()[0:2] for notice in merge.notices] == [["2", "episodes"], ["of", "1"]]
    assert problems_of(into(merge.chosen, tmp_path / "both")) == []


def test_different_episodes_of_one_id_and_revision_are_refused(
    dataset: Dataset, tmp_path: Path
) -> None:
    other = Path(shutil.copytree(dataset.path, tmp_path / "other"))
    revise(Path(dataset.episode_location(0)), succeed)

    def fail(found: EpisodeMetadata) -> None:
        found.success = False

    revise(other / list_episodes(other)[0], fail)
    with pytest.raises(UsageError, match=f"{dataset.ids[0]} in .*set and .*other"):
        plan_merge([refreshed(dataset), refreshed(other)])


def split(level: str, **lists: list[str]) -> SplitDocument:
    return SplitDocument.model_validate({"name": "default", "level": level, "lists": lists})


def test_splits_are_joined_or_refused(tmp_path: Path) -> None:
    found = open_dataset(write_dataset(tmp_path / "mugs"))
    for number in range(3):
        revise(Path(found.episode_location(number)), touch_a_mug)
    chosen = chosen_of(refreshed(found))
    halves = [
        {"default": split("episode", train=IDS[:1])},
        {"default": split("episode", val=IDS[1:])},
    ]
    joined = join_splits(halves, chosen)["default"]
    assert joined.lists == {"train": IDS[:1], "val": IDS[1:]}
    # An episode that is not taken leaves the lists.
    fewer = join_splits(halves, [one for one in chosen if one.id != IDS[2]])["default"]
    assert fewer.lists == {"train": IDS[:1], "val": [IDS[1]]}
    twice = [halves[0], {"default": split("episode", val=IDS[:1])}]
    with pytest.raises(UsageError, match=f"episode {IDS[0]} would be in train and val"):
        join_splits(twice, chosen)
    leak = [{"default": split("object", train=IDS[:1])}, {"default": split("object", val=IDS[1:])}]
    with pytest.raises(UsageError, match="object mug would be in train and val"):
        join_splits(leak, chosen)
    with pytest.raises(UsageError, match="by episode and by object"):
        join_splits([halves[0], leak[1]], chosen)


def test_removed_episodes_leave_a_note_and_no_trace_in_splits(dataset: Dataset) -> None:
    root = Path(dataset.path)
    write_splits(root, {"default": make_split(dataset)})
    remove_episodes(open_dataset(root), [IDS[0], IDS[2]], "the gel was torn")
    left = refreshed(dataset)
    assert left.ids == [IDS[1]]
    assert problems_of(root) == []
    assert list(chain.from_iterable(left.splits["default"].lists.values())) == [IDS[1]]
    (note,) = root.glob(f"episodes/*/{TOMBSTONE}{IDS[0]}.json")
    said = json.loads(note.read_bytes())
    assert (said["id"], said["revision"], said["reason"]) == (IDS[0], 1, "the gel was torn")
    assert said["digest"] in dataset.catalog.column("digest").to_pylist()


def test_a_removal_that_is_stopped_is_completed_by_the_next_command(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(_path: Path) -> None:
        raise KeyboardInterrupt

    root = Path(dataset.path)
    monkeypatch.setattr("exumi_data.editing.removal.shutil.rmtree", stop)
    with pytest.raises(KeyboardInterrupt):
        remove_episodes(dataset, [IDS[0]], "why")
    monkeypatch.undo()
    clean_leftovers(root)
    assert refreshed(dataset).ids == sorted(IDS[1:], key=dataset.ids.index)
    assert problems_of(root) == []
    assert not list(root.glob("episodes/*/.partial-*"))


def test_a_split_with_three_lists(tmp_path: Path) -> None:
    found = open_dataset(write_dataset(tmp_path / "set", 10))
    made = make_split(found, lists={"train": 8, "val": 1, "test": 1, "none": 0})
    assert {part: len(ids) for part, ids in made.lists.items()} == {
        "train": 8,
        "val": 1,
        "test": 1,
        "none": 0,
    }
    assert sorted(chain.from_iterable(made.lists.values())) == sorted(found.ids)
    with pytest.raises(UsageError, match="makes no sense"):
        make_split(found, lists={"train": 0})


def test_a_copy_that_is_stopped_leaves_nothing_half_written(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied: list[str] = []

    def stop_at_the_fourth(*arguments: object) -> None:
        if len(copied) == 3:
            raise KeyboardInterrupt
        copied.append(str(arguments[1]))
        copy_file(*arguments)  # type: ignore[arg-type]  # the very arguments

    monkeypatch.setattr(copying, "copy_file", stop_at_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        copy_episodes(chosen_of(dataset), tmp_path / "new")
    assert len(copied) == 3
    assert not list((tmp_path / "new").rglob(".partial-*"))
