import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.editing.documents import change_dataset, write_splits
from exumi_data.editing.revising import revise
from exumi_data.editing.trimming import trim_episode
from exumi_data.episode import open_episode
from exumi_data.model import EpisodeMetadata
from exumi_data.model.dataset import DatasetMetadata, SplitDocument
from exumi_data.release.changelog import change_lines, changelog_of
from exumi_data.release.changes import Changes, EpisodeChange, SplitChange, compare
from exumi_data.release.privacy import Removal
from exumi_data.store.pack import pack
from tests.exumi_data.builders import episode_id, write_dataset, write_small

IDS = [episode_id(number) for number in range(4)]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write_dataset(tmp_path_factory.mktemp("changes") / "old")
    write_splits(
        root, {"a": SplitDocument(name="a", level="episode", lists={"x": IDS[:1], "y": IDS[1:3]})}
    )
    return root


def differing(original: Path, tmp_path: Path, change: Callable[[Path], object]) -> Changes:
    other = tmp_path / "new"
    shutil.copytree(original, other)
    change(other)
    write_catalog(other, build_catalog(other)[0])
    return compare(original, other, workers=1)


def first(root: Path) -> Path:
    return root / episode_path(IDS[0])


def test_nothing(original: Path, tmp_path: Path) -> None:
    found = differing(original, tmp_path, lambda _root: None)
    assert found == Changes(3, (), (), {})
    assert found.step is None


def test_packing_alone_is_no_change(original: Path, tmp_path: Path) -> None:
    def packed(root: Path) -> None:
        pack(first(root))
        shutil.rmtree(first(root))

    assert differing(original, tmp_path, packed).step is None


def test_added_and_removed(original: Path, tmp_path: Path) -> None:
    found = differing(original, tmp_path, lambda root: write_small(root / episode_path(IDS[3]), 3))
    assert [(one.id, one.kind) for one in found.episodes] == [(IDS[3], "added")]
    assert (found.step, found.unchanged) == ("minor", 3)
    back = compare(tmp_path / "new", original, workers=1)
    assert [(one.id, one.kind) for one in back.episodes] == [(IDS[3], "removed")]
    assert back.step == "major"


def test_derived_values_computed_anew(original: Path, tmp_path: Path) -> None:
    def change(root: Path) -> None:
        # Rewriting the derived document in other words changes no digest of the recording.
        path = first(root) / "derived" / "zarr.json"
        path.write_bytes(path.read_bytes() + b"\n")

    found = differing(original, tmp_path, change)
    assert [one.kind for one in found.episodes] == ["reserialised"]
    assert found.step == "patch"


@pytest.mark.parametrize(
    ("change", "step"),
    [
        (lambda metadata: setattr(metadata, "success", True), "minor"),
        (lambda metadata: setattr(metadata.task, "name", "push"), "major"),
    ],
)
def test_relabelled(
    original: Path, tmp_path: Path, change: Callable[[EpisodeMetadata], None], step: str
) -> None:
    found = differing(original, tmp_path, lambda root: revise(first(root), change))
    assert [one.kind for one in found.episodes] == ["relabelled"]
    assert "revision" not in found.episodes[0].fields
    assert found.step == step


def test_changed_samples(original: Path, tmp_path: Path) -> None:
    with open_episode(first(original)) as episode:
        end = float(np.asarray(episode["width"].time)[-1]) * 1e-9
    found = differing(original, tmp_path, lambda root: trim_episode(first(root), None, end))
    assert [one.kind for one in found.episodes] == ["changed"]
    assert found.step == "major"


@pytest.mark.parametrize(
    ("name", "lists", "kinds", "step"),
    [
        ("b", {"x": IDS[:1]}, [("b", "added")], "minor"),
        ("a", {"x": IDS[:2], "y": IDS[2:3]}, [("a", "changed")], "major"),
        ("a", {"x": IDS[:1]}, [("a", "changed")], "major"),
        ("a", {"x": [*IDS[:1], IDS[3]], "y": IDS[1:3]}, [], None),
    ],
)
def test_splits(
    original: Path,
    tmp_path: Path,
    name: str,
    lists: dict[str, list[str]],
    kinds: list[tuple[str, str]],
    step: str | None,
) -> None:
    made = SplitDocument(name=name, level="episode", lists=lists)
    found = differing(original, tmp_path, lambda root: write_splits(root, {name: made}))
    assert [(one.name, one.kind) for one in found.splits] == kinds
    assert found.step == step
    back = compare(tmp_path / "new", original, workers=1)
    assert back.step == ("major" if kinds else None)


@pytest.mark.parametrize(
    ("field", "value", "step"), [("licence", "MIT", "major"), ("description", "more", "patch")]
)
def test_what_the_dataset_says(
    original: Path, tmp_path: Path, field: str, value: str, step: str
) -> None:
    def change(metadata: DatasetMetadata) -> None:
        setattr(metadata, field, value)

    found = differing(original, tmp_path, lambda root: change_dataset(root, change))
    assert list(found.document) == [field]
    assert found.step == step


def test_changelog_keeps_what_was_said(original: Path, tmp_path: Path) -> None:
    one = changelog_of("my data", "1.0.0", None, None, None)
    found = differing(original, tmp_path, lambda root: write_small(root / episode_path(IDS[3]), 3))
    assert list(change_lines(found)) == [f"1 episode added: {IDS[3]}"]
    two = changelog_of("my data", "1.1.0", "1.0.0", found, one)
    three = changelog_of("my data", "1.1.1", "1.1.0", Changes(4, (), (), {}), two)
    assert three.count("# Changes of my data\n") == 1
    assert [line for line in three.splitlines() if line.startswith("## ")] == [
        "## 1.1.1",
        "## 1.1.0",
        "## 1.0.0",
    ]
    assert three.endswith("## 1.0.0\n\nThe first release.\n")


def test_a_changelog_names_nobody_in_keys_and_in_names_of_splits() -> None:
    fields = {"acme:notes.by Zelda": (1, None), "task.name": ("way of Zelda", "way")}
    episode = EpisodeChange(IDS[0], "relabelled", fields)
    changes = Changes(0, (episode,), (SplitChange("of-zelda", "removed"),), {})
    hidden = Removal(frozenset({"operator"}), names={"Zelda": "operator"})
    text = changelog_of("my data", "2.0.0", "1.0.0", changes, None, hidden)
    assert "acme:notes.by removed something, now nothing" in text
    assert "split of-removed removed" in text
    assert f": {IDS[0]}" in text
    assert "zelda" not in text.lower()


def test_a_thousand_ways_of_relabelling_make_few_lines() -> None:
    changes = [
        EpisodeChange(f"{n:04}", "relabelled", {"task.name": ("a", f"b{max(n, 2)}")})
        for n in range(1000)
    ]
    *shown, last = change_lines(Changes(0, tuple(changes), (), {}))
    assert len(shown) == 20
    assert shown[0].startswith("3 episodes relabelled, the same samples (task.name ")
    assert last.startswith("978 episodes relabelled, the same samples, in other ways: 0022, ")
    assert last.endswith(" and 958 more")
