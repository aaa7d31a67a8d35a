"""What may be private is kept or removed explicitly, or nothing is released."""

from pathlib import Path

import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.cli.release_judge import judge_with
from exumi_data.dataset import open_dataset
from exumi_data.editing.documents import change_dataset
from exumi_data.manifest import write_manifest
from exumi_data.model.dataset import DatasetMetadata
from exumi_data.release.building import build_release
from exumi_data.release.privacy import find_private
from exumi_data.release.verifying import verify_release
from tests.exumi_data.builders import edit_metadata, episode_id, write_dataset
from tests.exumi_data.release.making import Release, planned, tree

KEY = b"sixteen bytes or more, kept secret"


@pytest.fixture
def named(tmp_path: Path) -> Path:
    """Three episodes, two by somebody who has a name, and an author with an address."""
    root = write_dataset(tmp_path / "named")
    (root / "LICENSE").write_text("Do with it what you like.\n")
    for number in (0, 1):
        folder = root / episode_path(episode_id(number))
        edit_metadata(folder, lambda said: said.update(operator="Ada Lovelace"))

    def signed(metadata: DatasetMetadata) -> None:
        metadata.authors = ["Grace Hopper <grace@example.org>"]

    change_dataset(root, signed)
    write_catalog(root, build_catalog(root)[0])
    return root


def test_nothing_is_released_before_each_kind_is_decided_about(named: Path, tmp_path: Path) -> None:
    told = "\n".join(planned(named, tmp_path / "out").problems)
    assert "operator 'Ada Lovelace' in 2 place(s)" in told
    assert "--keep operator, or --remove operator" in told
    assert "--keep email, or --remove email" in told
    half = planned(named, tmp_path / "out", keep=("email",)).problems
    assert all("operator" in problem for problem in half)
    assert half


def test_what_is_kept_is_released_as_it_is(named: Path, tmp_path: Path, release: Release) -> None:
    release(named, tmp_path / "out", keep=("operator", "email"))
    released = open_dataset(tmp_path / "out")
    assert [one.metadata.operator for one in released] == ["Ada Lovelace", "Ada Lovelace", None]
    assert [one.metadata.revision for one in released] == [1, 1, 1]


def test_what_is_removed_is_nowhere_in_the_release(
    named: Path, tmp_path: Path, release: Release
) -> None:
    before = tree(named)
    release(named, tmp_path / "out", remove=("operator", "email"))
    assert tree(named) == before
    assert find_private(tmp_path / "out") == []
    assert all(b"Lovelace" not in content for content in tree(tmp_path / "out").values())
    assert all(b"grace@example.org" not in content for content in tree(tmp_path / "out").values())
    revisions = [one.metadata.revision for one in open_dataset(tmp_path / "out")]
    assert revisions == [2, 2, 1]
    assert verify_release(tmp_path / "out").good


def test_a_key_makes_pseudonyms_that_stay(named: Path, tmp_path: Path, release: Release) -> None:
    names = []
    for target in (tmp_path / "one", tmp_path / "two"):
        release(named, target, keep=("email",), remove=("operator",), pseudonym_key=KEY)
        names.append([one.metadata.operator for one in open_dataset(target)])
    assert names[0] == names[1]
    assert str(names[0][0]).startswith("operator-")
    assert tree(tmp_path / "one") == tree(tmp_path / "two")
    assert all(KEY not in content for content in tree(tmp_path / "one").values())


def test_the_next_release_knows_what_was_taken_out(
    named: Path, tmp_path: Path, release: Release
) -> None:
    wishes = {"remove": ("operator", "email")}
    release(named, tmp_path / "one", **wishes)
    same = planned(named, tmp_path / "two", previous=tmp_path / "one", **wishes)
    assert same.changes is not None
    assert same.changes.episodes == ()
    kept = planned(named, tmp_path / "two", previous=tmp_path / "one", keep=("operator", "email"))
    assert kept.changes is not None
    assert {one.kind for one in kept.changes.episodes} == {"relabelled"}


def test_a_release_that_was_stopped_is_not_taken_up_with_another_decision(
    named: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from exumi_data.release import building

    class StoppedError(Exception):
        pass

    def stop(*_: object, **__: object) -> None:
        raise StoppedError

    with monkeypatch.context() as patched:
        patched.setattr(building, "describe", stop)
        kept = planned(named, tmp_path / "out", keep=("operator", "email"))
        with pytest.raises(StoppedError):
            build_release(kept, judge_with(1), workers=1)
    removed = planned(named, tmp_path / "out", remove=("operator", "email"))
    build_release(removed, judge_with(1), workers=1)
    assert find_private(tmp_path / "out") == []


def test_a_kind_that_there_is_not(named: Path, tmp_path: Path) -> None:
    (problem, *_) = planned(named, tmp_path / "out", keep=("names",)).problems
    assert "invalid kind (names). Supported values are operator, site" in problem


def test_both_kept_and_removed(named: Path, tmp_path: Path) -> None:
    wishes = {"keep": ("operator", "email"), "remove": ("operator",)}
    assert any(
        "both kept and removed: operator" in p
        for p in planned(named, tmp_path / "out", **wishes).problems
    )


def test_a_day_that_is_none(named: Path, tmp_path: Path) -> None:
    wishes = {"keep": ("operator", "email"), "published": "1 March 2026"}
    (problem,) = planned(named, tmp_path / "out", **wishes).problems
    assert "is no day" in problem


def test_a_person_is_found_wherever_the_dataset_has_the_name(
    named: Path, tmp_path: Path, release: Release
) -> None:
    told = {
        "instruction": "filmed by ADA LOVELACE",
        "name": "ada lovelace's way",
    }
    edit_metadata(named / episode_path(episode_id(2)), lambda said: said.update(task=told))

    def described(metadata: DatasetMetadata) -> None:
        metadata.description = "Collected by Ada Lovelace."
        metadata.authors = ["Ada Lovelace <ada@example.org>"]

    change_dataset(named, described)
    write_catalog(named, build_catalog(named)[0])
    release(named, tmp_path / "out", remove=("operator", "email"))
    released = open_dataset(tmp_path / "out")
    assert released.metadata.description == "Collected by removed."
    assert released.metadata.authors == ["Ada Lovelace"]  # who signs wants to be named
    for path, content in tree(tmp_path / "out" / "episodes").items():
        assert b"lovelace" not in content.lower(), path
    assert 'family-names: "Lovelace"' in (tmp_path / "out" / "CITATION.cff").read_text()
    assert released[2].metadata.task.instruction == "filmed by removed"


def test_a_changelog_does_not_tell_who_was_taken_out(
    named: Path, tmp_path: Path, release: Release
) -> None:
    def said(text: str) -> None:
        edit_metadata(
            named / episode_path(episode_id(0)),
            lambda it: it.update(task={"name": "press", "instruction": text}),
        )
        write_catalog(named, build_catalog(named)[0])

    said("as Ada Lovelace does")
    release(named, tmp_path / "one", keep=("operator", "email"))
    old = tmp_path / "one" / "CHANGELOG.md"
    old.write_text(old.read_text() + "\nThanks to Ada Lovelace.\n")
    write_manifest(tmp_path / "one")
    said("as Ada Lovelace did")
    release(
        named, tmp_path / "two", keep=("email",), remove=("operator",), previous=tmp_path / "one"
    )
    text = (tmp_path / "two" / "CHANGELOG.md").read_text()
    assert "operator something, now nothing" in text
    assert 'task.instruction "as removed does", now "as removed did"' in text
    assert "Thanks to removed." in text
    assert "Lovelace" not in text


def test_a_changelog_does_not_tell_who_was_in_the_release_before(
    named: Path, tmp_path: Path, release: Release
) -> None:
    signed = ("email",)

    def said(operator: str | None, thing: str) -> None:
        for number in (0, 1):
            folder = named / episode_path(episode_id(number))
            edit_metadata(
                folder, lambda it: it.update(operator=operator, annotations={"object": thing})
            )
        write_catalog(named, build_catalog(named)[0])

    said("Ada Lovelace", "Ada Lovelace's mug")
    release(named, tmp_path / "one", keep=("operator", *signed))
    old = tmp_path / "one" / "CHANGELOG.md"
    noted = "\nBy Ada Lovelace, see /data/shelf/notes.txt, mail grace@example.org, 0.2 N.\n"
    old.write_text(old.read_text() + noted)
    write_manifest(tmp_path / "one")
    said(None, "mug")
    # Nothing is taken out of this release: the names stand in the one before only.
    release(named, tmp_path / "two", keep=signed, previous=tmp_path / "one")
    text = (tmp_path / "two" / "CHANGELOG.md").read_text()
    assert 'annotations.object "removed\'s mug", now "mug"' in text
    assert "operator something, now nothing" in text
    # What was written by hand goes through the same gate: what is not kept is taken out.
    assert "\nBy removed, see notes.txt, mail grace@example.org, 0.2 N.\n" in text
    release(named, tmp_path / "three", keep=("operator", *signed), previous=tmp_path / "one")
    kept = (tmp_path / "three" / "CHANGELOG.md").read_text()
    assert 'annotations.object "Ada Lovelace\'s mug", now "mug"' in kept
    assert "\nBy Ada Lovelace, see notes.txt" in kept
