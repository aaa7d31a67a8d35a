"""``exumi dataset``: what is told, what is refused, and that a dry run does nothing."""

import errno
import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from exumi_data.cli.app import app
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.editing import copying
from exumi_data.editing.documents import change_dataset
from exumi_data.errors import NotAnEpisodeError, UsageError
from exumi_data.manifest import write_manifest
from exumi_data.model.dataset import DatasetMetadata, Release
from exumi_data.store.stream_copy import copy_file
from exumi_validators import validate
from tests.exumi_data.builders import episode_id, write_dataset

IDS = [episode_id(number) for number in range(3)]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "set")


def run(verb: str, *arguments: object) -> Result:
    return CliRunner().invoke(app, ["dataset", verb, *map(str, arguments)])


def good(verb: str, *arguments: object) -> str:
    done = run(verb, *arguments)
    assert done.exit_code == 0, done.output
    return done.stdout


def state_of(root: Path) -> dict[str, bytes]:
    return {
        str(one.relative_to(root)): one.read_bytes() for one in root.rglob("*") if one.is_file()
    }


@pytest.mark.parametrize(
    "arguments",
    [
        ("relabel", "SET", "--all", "--task", "push"),
        ("rate", "SET", IDS[0], "--success"),
        ("trim", "SET", "--all", "--end", "0.2"),
        ("remove", "SET", "--all", "--reason", "why"),
        ("split", "SET"),
        ("select", "SET", "NEW", "--all"),
        ("merge", "SET", "SET", "--out", "NEW"),
    ],
)
def test_a_dry_run_writes_nothing(root: Path, arguments: tuple[str, ...], tmp_path: Path) -> None:
    before = state_of(tmp_path)
    named = {"SET": str(root), "NEW": str(tmp_path / "new")}
    text = good(*(named.get(one, one) for one in arguments), "--dry-run")
    assert "would be" in text or "would change" in text
    assert state_of(tmp_path) == before
    # And the same, done, changes something, and leaves valid data.
    yes = ["--yes"] if arguments[0] == "remove" else []
    good(*(named.get(one, one) for one in arguments), *yes)
    assert state_of(tmp_path) != before
    for dataset in (root, tmp_path / "new"):
        if dataset.exists():
            found = validate(dataset).problems
            assert [one for one in found if one.severity == "error"] == []
            assert not [one for one in found if one.code.startswith("CAT")]


def test_what_changed_is_told_once_for_those_alike(root: Path) -> None:
    text = good("relabel", root, "--all", "--task", "push", "--object-id", "mug")
    assert text.count('task.name: "press" -> "push"') == 1
    assert "3 of 3 episodes changed" in text
    told = json.loads(good("relabel", root, IDS[0], "--object-id", "cup", "-f", "json"))
    assert told["episodes"][0]["revision"] == 3
    assert told["episodes"][0]["changed"] == {"annotations.object_id": ["mug", "cup"]}
    assert "0 of 3 episodes changed" in good("relabel", root, "--all", "--task", "push")
    objects = open_dataset(root).catalog.column("object_id").to_pylist()
    assert sorted(objects) == ["cup", "mug", "mug"]


def test_removal_asks_first(root: Path) -> None:
    before = state_of(root)
    done = run("remove", root, IDS[0], "--reason", "torn")
    assert (done.exit_code, state_of(root)) == (2, before)
    assert "--yes" in done.output
    good("remove", root, IDS[0], "--reason", "torn", "--yes")
    assert sorted(open_dataset(root).ids) == sorted(IDS[1:])


def test_what_cannot_be_read_can_be_removed(root: Path) -> None:
    good("split", root, "--lists", "train=2,val=1")
    for number, name in enumerate(IDS[:2]):
        (document,) = root.glob(f"episodes/*/{name}.zarr/zarr.json")
        if number:
            document.unlink()
        else:
            document.write_text("{broken")
    run("remove", root, "--unreadable", "--reason", "the disk failed")  # refused, but indexed
    blocked = run("rate", root, "--all", "--success")
    assert blocked.exit_code == 2
    assert "remove" in blocked.output
    assert "--unreadable" in blocked.output
    before = state_of(root)
    told = good("remove", root, "--unreadable", "--reason", "why", "--dry-run")
    assert "2 of 3 episodes (unreadable) would be removed" in told
    assert "not valid JSON" in told
    assert state_of(root) == before
    done = json.loads(good("remove", root, "--unreadable", "--reason", "why", "-y", "-f", "json"))
    assert sorted(done["removed"]) == sorted(IDS[:2])
    assert len(done["problems"]) == 2
    left = open_dataset(root)
    assert left.ids == [IDS[2]]
    assert [one for ids in left.splits["default"].lists.values() for one in ids] == [IDS[2]]
    assert [one for one in validate(root).problems if one.severity == "error"] == []
    note = next(root.glob(f"episodes/*/.removed-{IDS[0]}.json")).read_text()
    assert "why" in note
    assert str(root.parent) not in note
    assert "0 of 1 episode (" in good("remove", root, "--unreadable", "--reason", "why")


def test_what_may_be_whole_is_not_removed_as_unreadable(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [next(root.glob(f"episodes/*/{name}.zarr/zarr.json")) for name in IDS]
    for path, (key, value) in zip(paths, [("version", "2.0"), ("misspelt", 1)], strict=False):
        document = json.loads(path.read_bytes())
        document["attributes"]["exumi"][key] = value
        path.write_text(json.dumps(document))
    real = os.open

    def refuse(path: str, flags: int, *more: int, **others: int) -> int:
        if str(path) == str(paths[2]):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
        return real(path, flags, *more, **others)

    monkeypatch.setattr(os, "open", refuse)
    done = run("remove", root, "--unreadable", "--reason", "why", "--yes")
    assert done.exit_code == 1
    assert "0 of 3 episodes" in done.output
    assert done.output.count("left alone: ") == 3
    told = run("remove", root, "--unreadable", "--reason", "why", "--yes", "-f", "json")
    assert len(json.loads(told.stdout)["left_alone"]) == 3
    assert all(path.exists() for path in paths)


def test_of_what_is_no_dataset_nothing_is_removed_as_unreadable(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nowhere"):
        done = run("remove", path, "--unreadable", "--reason", "why", "--dry-run")
        assert done.exit_code == 2
        assert "no dataset.json: not an exUMI dataset" in done.output


def test_unreadable_episodes_are_not_chosen_otherwise(root: Path) -> None:
    refused = run("remove", root, "--unreadable", "--all", "--reason", "why", "--yes")
    assert refused.exit_code == 2
    assert "--unreadable says which" in refused.output
    assert sorted(open_dataset(root).ids) == sorted(IDS)


def test_selected_datasets_are_not_mixed_with_others(root: Path, tmp_path: Path) -> None:
    new = tmp_path / "new"
    good("split", root, "--lists", "train=2,val=1")
    text = good("select", root, new, "--split", "default/val", "--name", "held out")
    assert ": 1 episode, " in text
    found = open_dataset(new)
    assert (found.metadata.name, len(found), list(found.splits)) == ("held out", 1, ["default"])
    assert found.metadata.made_by is not None
    # Once more is no harm; others are.
    good("select", root, new, "--split", "default/val")
    assert "holds 1 other" in run("select", root, new, "--split", "default/train").output
    assert "is one of the datasets" in run("select", root, root, "--all").output
    inside = root / "episodes" / "new"
    assert "lies in one" in run("select", root, inside, "--all").output


def test_licences_that_differ_have_to_be_decided(root: Path, tmp_path: Path) -> None:
    document = json.loads((root / "dataset.json").read_bytes())
    other = write_dataset(tmp_path / "other", 4)
    (other / "dataset.json").write_text(json.dumps(document | {"licence": "MIT"}))
    both = tmp_path / "both"
    assert "different licences: CC0-1.0, MIT" in run("merge", root, other, "--out", both).output
    assert not both.exists()
    good("merge", root, other, "--out", both, "--licence", "MIT")
    assert (len(open_dataset(both)), open_dataset(both).metadata.licence) == (4, "MIT")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("relabel", "SET", "--all"), "nothing is to be said anew"),
        (("relabel", "SET", "--task", "x"), "which episodes?"),
        (("relabel", "SET", "--all", "--regime", "work"), "regime"),
        (("relabel", "SET", "--all", "--clear", "task"), "has to have: task"),
        (("rate", "SET", "--all"), "no judgement"),
        (("rate", "SET", "--all", "--note", "late"), "CODE=TEXT"),
        (("rate", "SET", "--all", "--success", "--unknown"), "not both"),
        (("trim", "SET", "--all"), "from when to when"),
        (("relabel", "SET", "--all", "--licence", "bogus"), "no SPDX licence expression"),
        (("relabel", "SET", "--all", "--licence", "CC BY"), "no SPDX licence expression"),
        (("relabel", "SET", "--all", "--licence", ""), "the licence is empty"),
        (("merge", "SET", "SET", "--out", "NEW", "--licence", "bogus"), "no SPDX licence"),
        (("relabel", "SET", "--all", "--clear", "foo"), "Fields are task, instruction, regime"),
        (("split", "SET", "--lists", "train"), "train=8,val=1"),
        (("split", "SET", "--lists", "../train=8,val=1"), "'../train' is no name of a list"),
        (("split", "SET", "--lists", "..=8,val=1"), "no name of a list"),
        (("split", "SET", "--lists", "a/b=8,val=1"), "no name of a list"),
        (("split", "SET", "--lists", f"{'x' * 65}=8,val=1"), "At most 64 letters"),
        (("split", "SET", "--lists", f"train={'9' * 5000},val=1"), "more than 9 digits"),
        (("split", "SET", "--name", "x" * 65), "at most 64 letters"),
        (("split", "SET", "--by", "object"), "no object_id"),
        (("split", "SET", "--name", "A B"), "no name of a split"),
        (("relabel", "SET", "--all", "--task", " "), "task"),
        (("merge", "SET", "--out", "NEW"), "two or more"),
    ],
)
def test_mistakes_are_told(root: Path, arguments: tuple[str, ...], says: str) -> None:
    before = state_of(root)
    named = {"SET": str(root), "NEW": str(root.parent / "new")}
    done = run(*(named.get(one, one) for one in arguments))
    assert done.exit_code == 2, done.output
    assert says in done.output
    assert "bug" not in done.output
    assert state_of(root) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("relabel", "--all", "--task", "push"),
        ("rate", "--all", "--success"),
        ("trim", "--all", "--end", "0.2"),
        ("remove", "--all", "--reason", "why", "--yes"),
        ("split",),
    ],
)
@pytest.mark.parametrize("dry", [(), ("--dry-run",)])
def test_a_release_is_not_changed(
    root: Path, arguments: tuple[str, ...], dry: tuple[str, ...]
) -> None:
    write_manifest(root)
    before = state_of(root)
    refused = run(arguments[0], root, *arguments[1:], *dry)
    assert refused.exit_code == 2
    assert "releases are not changed" in refused.stderr
    assert state_of(root) == before


def test_a_part_of_a_release_is_no_release(root: Path, tmp_path: Path) -> None:
    def released(metadata: DatasetMetadata) -> None:
        metadata.release = Release(version="1.2.3")

    change_dataset(root, released)
    good("select", root, tmp_path / "new", "--episode", IDS[0])
    assert open_dataset(tmp_path / "new").metadata.release is None


def test_what_contradicts_itself_or_says_nothing(root: Path) -> None:
    before = state_of(root)
    both = run("relabel", root, "--all", "--object", "mug", "--clear", "object")
    assert "both said and cleared: object" in both.stderr
    silent = run("remove", root, "--all", "--reason", " ", "--yes")
    assert "no reason is given" in silent.stderr
    assert both.exit_code == silent.exit_code == 2
    assert state_of(root) == before


@pytest.mark.parametrize("dry", [(), ("--dry-run",)])
def test_a_source_is_not_written_over_where_all_of_it_is_older(
    root: Path, tmp_path: Path, dry: tuple[str, ...]
) -> None:
    good("select", root, tmp_path / "later", "--all")
    good("rate", tmp_path / "later", "--all", "--success")
    before = state_of(tmp_path)
    refused = run("merge", root, tmp_path / "later", "--out", root, *dry)
    assert refused.exit_code == 2
    assert "is one of the datasets that are read" in refused.stderr
    assert state_of(tmp_path) == before


@pytest.mark.parametrize("dry", [(), ("--dry-run",)])
def test_what_was_changed_since_is_not_written_over(
    root: Path, tmp_path: Path, dry: tuple[str, ...]
) -> None:
    good("select", root, tmp_path / "copy", "--all")
    good("select", root, tmp_path / "copy", "--all")  # the same again is no harm
    good("rate", tmp_path / "copy", IDS[1], "--success")
    before = state_of(tmp_path)
    refused = run("select", root, tmp_path / "copy", "--all", *dry)
    assert refused.exit_code == 2
    assert "holds 1 of these episodes as they are not here" in refused.stderr
    assert state_of(tmp_path) == before


def stopped_after(
    monkeypatch: pytest.MonkeyPatch, episodes: int, verb: str, *arguments: object
) -> Result:
    """Run a verb, and press Ctrl-C while the next episode is copied."""
    seen: set[Path] = set()

    def copy(store: object, member: str, target: Path) -> None:
        seen.add(next(one for one in target.parents if one.name.startswith(".partial-")))
        if len(seen) > episodes:
            raise KeyboardInterrupt
        copy_file(store, member, target)  # type: ignore[arg-type]  # passed on

    with monkeypatch.context() as patch:
        patch.setattr(copying, "copy_file", copy)
        done = run(verb, *arguments)
    assert done.exit_code == 130
    assert "is not finished, and no dataset yet. Run the same command again" in done.stderr
    return done


@pytest.mark.parametrize("verb", ["select", "merge"])
@pytest.mark.parametrize("there", [False, True])
def test_what_was_stopped_is_no_dataset_until_the_same_command_ends(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str, there: bool
) -> None:
    good("split", root)
    other = write_dataset(tmp_path / "other")
    asked = {"select": [root, "NEW", "--all"], "merge": [root, other, "--out", "NEW"]}[verb]

    def of(new: Path) -> list[object]:
        return [new if one == "NEW" else one for one in asked]

    good(verb, *of(tmp_path / "whole"))
    new = tmp_path / "new"
    if there:
        new.mkdir()
    stopped_after(monkeypatch, 2, verb, *of(new))
    copied = sorted(new.glob("episodes/*/*.zarr"))
    assert len(copied) == 2
    with pytest.raises(NotAnEpisodeError, match="not finished: what was copying"):
        open_dataset(new)
    for other_verb in (["validate"], ["stats"], ["info"], ["release", "--dry-run"], ["index"]):
        judged = CliRunner().invoke(app, [*other_verb, str(new)])
        assert judged.exit_code in (1, 2), other_verb
    with pytest.raises(UsageError, match="holds a dataset that is not finished"):
        create_dataset(new, open_dataset(root).metadata)
    different = run("select", root, new, "--episode", copied[0].stem)
    assert "It is not finished: run the command that began it again" in different.stderr
    inodes = [one.stat().st_ino for one in copied]
    good(verb, *of(new))
    assert [one.stat().st_ino for one in copied] == inodes
    assert state_of(new) == state_of(tmp_path / "whole")


def test_a_dataset_to_which_episodes_are_added_is_none_while_it_is_stopped(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = tmp_path / "new"
    good("select", root, new, "--episode", IDS[0], "--name", "mine")
    good("split", new, "--name", "own")
    stopped_after(monkeypatch, 1, "select", root, new, "--all")
    with pytest.raises(NotAnEpisodeError, match="not finished"):
        open_dataset(new)
    good("select", root, new, "--all")
    done = open_dataset(new)
    assert (done.metadata.name, done.metadata.splits, len(done)) == ("mine", ["own"], 3)


def test_a_dataset_without_its_catalog_is_not_finished(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good("split", root)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("exumi_data.destination.write_catalog", stop)
        assert run("select", root, tmp_path / "new", "--all").exit_code == 130
    with pytest.raises(NotAnEpisodeError, match="not finished"):
        open_dataset(tmp_path / "new")
    good("select", root, tmp_path / "new", "--all")
    assert list(open_dataset(tmp_path / "new").splits) == ["default"]


@pytest.mark.parametrize("dry", [(), ("--dry-run",)])
def test_what_cannot_be_trimmed_is_told_of_all_before_any_is(
    root: Path, dry: tuple[str, ...]
) -> None:
    first, second, third = (next(root.glob(f"episodes/*/{one}.zarr")) for one in IDS)
    shard = next(one for one in (third / "streams/tactile/data/c").rglob("*") if one.is_file())
    shard.write_bytes(shard.read_bytes()[:-5])
    before = state_of(root)
    refused = run("trim", root, "--all", "--end", "0.2", *dry)
    assert refused.exit_code == 2
    assert IDS[2] in refused.stderr
    assert state_of(root) == before
    (second / "streams/width/data/zarr.json").unlink()
    before = state_of(root)
    refused = run("trim", root, "--all", "--end", "0.2", *dry)
    assert "2 episodes cannot be trimmed" in refused.stderr
    assert "".join(refused.stderr.split()).count(".zarr") >= 2
    assert [one for one in IDS if one in "".join(refused.stderr.split())] == IDS[1:]
    assert state_of(root) == before
    good("trim", root, first.stem, "--end", "0.2", *dry)


def test_licences_and_labels_as_they_are_written_down(root: Path) -> None:
    good("relabel", root, IDS[0], "--licence", "cc-by-4.0", "--label", "hardness=7:0..10")
    good("relabel", root, IDS[1], "--licence", "NOASSERTION")
    found = {one.id: one.metadata for one in open_dataset(root)}
    assert [found[one].licence for one in IDS[:2]] == ["CC-BY-4.0", "NOASSERTION"]
    refused = run("relabel", root, "--all", "--clear", "hardnes")
    assert refused.exit_code == 2
    assert "labels of these episodes: hardness" in refused.stderr
    assert "1 of 3 episodes changed" in good("relabel", root, "--all", "--clear", "hardness")


def test_episodes_that_are_links_are_not_left_out_in_silence(root: Path, tmp_path: Path) -> None:
    episode = next(root.glob("episodes/*/*"))
    outside = episode.rename(tmp_path / episode.name)
    episode.symlink_to(outside)
    done = run("select", root, tmp_path / "new", "--all")
    assert done.exit_code == 0
    assert f"1 link in {root / 'episodes'}, not followed" in " ".join(done.stderr.split())
