import errno
import json
import os
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.cli.app import app
from exumi_data.cli.release_judge import judge_with
from exumi_data.dataset import open_dataset
from exumi_data.editing.documents import write_splits
from exumi_data.editing.revising import revise
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.model.dataset import SplitDocument
from exumi_data.release.building import build_release, partial_folder
from exumi_data.release.judging import Judgement
from exumi_data.release.packing import JOURNAL_NAME
from exumi_data.release.planning import SplitWish
from exumi_data.release.verifying import verify_release
from exumi_data.store.pack import pack
from exumi_validators import validate
from tests.exumi_data.builders import edit_metadata, episode_id, write_dataset, write_small
from tests.exumi_data.release.making import Release, planned, tree


def test_a_release_is_valid_and_complete(source: Path, tmp_path: Path, release: Release) -> None:
    before = tree(source)
    built = release(source, tmp_path / "out", split=SplitWish())
    root = tmp_path / "out"
    report = validate(root)
    assert report.valid
    assert report.codes() == validate(source).codes()
    dataset = open_dataset(root)
    assert dataset.metadata.licence == "LicenseRef-tests"
    assert dataset.metadata.release is not None
    assert dataset.metadata.release.version == built.version == "1.0.0"
    assert sorted(dataset.splits["default"].lists) == ["train", "val"]
    assert [one.digest() for one in dataset] == [one.digest() for one in open_dataset(source)]
    assert all(path.endswith(".zarr.zip") for path in dataset.catalog["path"].to_pylist())
    assert tree(source) == before
    assert not [path for path in tree(root) if "/." in f"/{path}"]
    assert verify_release(root, fingerprint=built.fingerprint).good


def test_the_same_bytes_twice(tmp_path: Path, release: Release) -> None:
    """From folders or from zips, with one process or two, from any folder, in any order."""
    one = write_dataset(tmp_path / "one", 9)
    (one / "LICENSE").write_text("mine")
    two = tmp_path / "elsewhere" / "two"
    shutil.copytree(one, two)
    for number in (0, 4):
        folder = two / episode_path(episode_id(number))
        pack(folder)
        shutil.rmtree(folder)
    (two / "catalog.parquet").unlink()
    write_catalog(two, build_catalog(two)[0])
    first = release(one, tmp_path / "a", split=SplitWish())
    second = release(two, tmp_path / "b", split=SplitWish(), workers=2)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    assert first.fingerprint == second.fingerprint
    # A release of a release.
    release(tmp_path / "a", tmp_path / "c")
    assert tree(tmp_path / "c") == tree(tmp_path / "a")


def test_a_run_that_was_stopped_goes_on(source: Path, tmp_path: Path, release: Release) -> None:
    target, work = tmp_path / "out", partial_folder(tmp_path / "out")

    def stop(done: int, _total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_release(planned(source, target), judge_with(1), workers=1, on_progress=stop)
    assert not target.exists()
    packed = {path: path.stat().st_mtime_ns for path in work.rglob("*.zarr.zip")}
    assert len(packed) == 2
    # One of them is touched, and the journal is cut in its last line; both are seen.
    touched, kept = sorted(packed)
    touched.write_bytes(touched.read_bytes()[:-1] + b"x")
    with (work / JOURNAL_NAME).open("a") as file:
        file.write('{"by": "0.')
    (work / "splits").mkdir()
    (work / "splits" / "of-another-plan.json").write_text("{}")
    inode = kept.stat().st_ino
    release(source, target)
    assert not work.exists()
    assert (target / kept.relative_to(work)).stat().st_ino == inode
    release(source, tmp_path / "whole")
    assert tree(target) == tree(tmp_path / "whole")


def test_an_episode_that_changed_meanwhile_is_packed_again(
    source: Path, tmp_path: Path, release: Release
) -> None:
    def stop(done: int, _total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_release(planned(source, tmp_path / "out"), judge_with(1), workers=1, on_progress=stop)
    for number in range(3):
        revise(
            source / episode_path(episode_id(number)),
            lambda metadata: setattr(metadata, "success", True),
        )
    write_catalog(source, build_catalog(source)[0])
    release(source, tmp_path / "out")
    assert open_dataset(tmp_path / "out").catalog["success"].to_pylist() == [True] * 3


def test_all_problems_at_once(source: Path, tmp_path: Path) -> None:
    leaking = {"a": [episode_id(0)], "b": [episode_id(0), episode_id(1)]}
    write_splits(source, {"bad": SplitDocument(name="bad", level="episode", lists=leaking)})
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "something").touch()
    plan = planned(
        source, tmp_path / "out", licence="free", version="one", split=SplitWish("object")
    )
    said = "\n".join(plan.problems)
    for words in ("is there already", "'free' is no SPDX", "no object_id", "'one' is no version"):
        assert words in said
    assert any("SPLIT-005" in error for error in plan.judgement.errors)
    with pytest.raises(UsageError, match="problems"):
        build_release(plan, judge_with(1))


@pytest.mark.parametrize("level", ["episode", "part"])
def test_a_leak_is_refused(tmp_path: Path, level: str) -> None:
    root = write_dataset(tmp_path / "set", 0)
    for number in range(2):
        write_small(root / episode_path(episode_id(number)), number, annotations={"part_id": "egg"})
    write_catalog(root, build_catalog(root)[0])
    ids = [episode_id(0), episode_id(1 if level == "part" else 0)]
    made = SplitDocument(
        name="bad",
        level=level,  # type: ignore[arg-type]  # one of the two
        lists={"a": ids[:1], "b": ids[1:]},
    )
    write_splits(root, {"bad": made})
    plan = planned(root, tmp_path / "out")
    assert any("would be in a and b of 'bad'" in problem for problem in plan.problems)


def test_versions_follow_the_changes(source: Path, tmp_path: Path, release: Release) -> None:
    release(source, tmp_path / "v1")
    write_small(source / episode_path(episode_id(7)), 7)
    write_catalog(source, build_catalog(source)[0])
    built = release(source, tmp_path / "v2", previous=tmp_path / "v1")
    assert built.version == "1.1.0"
    assert built.changes is not None
    assert [one.kind for one in built.changes.episodes] == ["added"]
    log = (tmp_path / "v2" / "CHANGELOG.md").read_text()
    assert log.index("## 1.1.0") < log.index(episode_id(7)) < log.index("## 1.0.0")
    document = json.loads((tmp_path / "v2" / "dataset.json").read_text())
    assert document["release"] == {"version": "1.1.0", "previous": "1.0.0"}
    plan = planned(source, tmp_path / "v3", previous=tmp_path / "v1", version="1.0.1")
    assert any("call for a minor" in problem for problem in plan.problems)
    plan = planned(source, tmp_path / "v3", previous=source)
    assert any("is no release" in problem for problem in plan.problems)


@pytest.mark.parametrize("damage", ["bit", "episode", "manifest"])
def test_damage_of_the_release_before_passes_for_no_change(
    source: Path, tmp_path: Path, release: Release, damage: str
) -> None:
    release(source, tmp_path / "v1")
    episode = min((tmp_path / "v1").glob("episodes/*/*.zip"))
    if damage == "bit":
        content = bytearray(episode.read_bytes())
        content[len(content) // 2] ^= 1
        episode.write_bytes(content)
        told = "is not as it was released: 1 finding, the first: "
        told += f"{episode.relative_to(tmp_path / 'v1').as_posix()} has other bytes"
    elif damage == "episode":
        episode.unlink()
        told = f"/{episode.name} is missing. See exumi release verify {tmp_path / 'v1'}"
    else:
        (tmp_path / "v1" / "manifest.json").unlink()
        told = "has no manifest.json"
    plan = planned(source, tmp_path / "v2", previous=tmp_path / "v1", version="1")
    assert told in plan.problems[0]
    assert plan.changes is None
    # The other reasons are listed as well.
    assert "'1' is no version" in plan.problems[1]


def test_bytes_that_the_catalog_does_not_know(source: Path, tmp_path: Path) -> None:
    """A flipped bit in a table of numbers may still be valid; the digest tells."""
    shard = next((source / episode_path(episode_id(1))).glob("streams/width/data/c/0"))
    content = bytearray(shard.read_bytes())
    plan = planned(source, tmp_path / "out")
    content[1] ^= 1
    shard.write_bytes(content)
    with pytest.raises(DamagedDataError, match="not those that the catalog knows"):
        build_release(plan, judge_with(1), workers=1)
    assert not (tmp_path / "out").exists()


def test_what_describes_a_release_is_listed(source: Path, tmp_path: Path, release: Release) -> None:
    said: dict[str, Any] = {
        "published": "2026-03-01",
        "url": "https://data.example/touch",
        "authors": ("Ada Example", "Our Lab"),
        "description": "Touch, and what was touched.",
        "citation": "Example: Touch. 2026.",
    }
    release(source, tmp_path / "out", **said)
    listed = json.loads((tmp_path / "out" / "manifest.json").read_text())
    paths = {one["path"] for one in listed["files"]}
    assert {"README.md", "croissant.json", "LICENSE", "CHANGELOG.md"} <= paths
    described = json.loads((tmp_path / "out" / "croissant.json").read_text())
    assert described["version"] == "1.0.0"
    assert described["datePublished"] == "2026-03-01"
    assert described["url"] == "https://data.example/touch"
    assert [one["name"] for one in described["creator"]] == ["Ada Example", "Our Lab"]
    card = (tmp_path / "out" / "README.md").read_text()
    assert "Touch, and what was touched." in card
    assert "Example: Touch. 2026." in card
    cff = (tmp_path / "out" / "CITATION.cff").read_text()
    assert "https://data.example/touch" in cff
    assert "family-names" in cff
    assert verify_release(tmp_path / "out").good


def test_what_a_stranger_will_miss_is_told(source: Path, tmp_path: Path) -> None:
    options = ("--author", "--description", "--published", "--url")
    told = [n.split(": ")[-1].split()[0] for n in planned(source, tmp_path / "a").notices]
    assert [option for option in told if option in options] == list(options)
    said: dict[str, Any] = {
        "authors": ("Ada",), "description": "x", "published": "2026-03-01", "url": "https://x.example",
    }  # fmt: skip
    told = [n.split(": ")[-1].split()[0] for n in planned(source, tmp_path / "a", **said).notices]
    assert [option for option in told if option in options] == []
    (problem,) = planned(source, tmp_path / "a", **{**said, "url": "data.example"}).problems
    assert "no address" in problem


def test_an_invalid_result_keeps_its_partial_name(source: Path, tmp_path: Path) -> None:
    def strict(path: Path, thorough: bool) -> Judgement:
        return Judgement() if thorough else Judgement(errors=(f"{path.name} is wrong",))

    plan = planned(source, tmp_path / "out")
    with pytest.raises(DamagedDataError, match="would not be valid"):
        build_release(plan, strict, workers=1)
    assert not (tmp_path / "out").exists()


def test_the_source_is_not_written_into(source: Path) -> None:
    plan = planned(source, source / "release")
    assert any("lies in the dataset" in problem for problem in plan.problems)


def test_a_full_disk_is_said_once(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from exumi_data.release import packing

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(packing, "pack_store", full)
        with pytest.raises(OSError, match="No space left") as told:
            build_release(planned(source, tmp_path / "out"), judge_with(1), workers=1)
    assert told.value.errno == errno.ENOSPC
    build_release(planned(source, tmp_path / "out"), judge_with(1), workers=1)
    assert verify_release(tmp_path / "out").good


@pytest.mark.parametrize("word", ["NOASSERTION", "NONE"])
def test_episodes_that_nobody_may_use_are_not_released(
    source: Path, tmp_path: Path, release: Release, word: str
) -> None:
    """The release's own licence does not make theirs."""
    for number in (0, 2):
        folder = source / episode_path(episode_id(number))
        edit_metadata(folder, lambda said: said.update(licence=word))
    write_catalog(source, build_catalog(source)[0])
    plan = planned(source, tmp_path / "a")
    (problem,) = plan.problems
    assert problem.startswith(f"2 of 3 episodes say {word}, which is no licence")
    command = problem[problem.index("exumi dataset") :]
    assert not any(word in notice for notice in plan.notices)
    # So, too, where it is not known either under which licence the whole is released.
    assert "--licence SPDX" in planned(source, tmp_path / "a", licence=word).problems[1]
    done = CliRunner().invoke(app, shlex.split(command)[1:])
    assert done.exit_code == 0, done.output
    release(source, tmp_path / "a")
    licences = {one.metadata.licence for one in open_dataset(tmp_path / "a")}
    assert licences == {"LicenseRef-tests", "CC0-1.0"}
