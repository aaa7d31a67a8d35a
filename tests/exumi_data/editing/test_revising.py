"""A revision changes what is said of an episode, and nothing else, in a folder and in a zip."""

from pathlib import Path

import pytest

from exumi_data.editing import revising
from exumi_data.editing.labels import Rating, parse_label, rate, relabel
from exumi_data.editing.revising import revise
from exumi_data.episode import open_episode
from exumi_data.errors import MetadataError, UsageError
from exumi_data.model import EpisodeMetadata, QualityNote
from exumi_data.model.description import Annotations, Label
from exumi_data.store.pack import pack
from exumi_validators import validate
from tests.exumi_data.builders import edit_json, metadata, write_episode


@pytest.fixture(params=["folder", "zip"])
def episode(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = write_episode(tmp_path / "one.zarr")
    if request.param == "folder":
        return path
    return pack(path, tmp_path / "packed" / "one.zarr.zip")


def content_of(path: Path) -> dict[str, bytes]:
    with open_episode(path) as episode:
        return {name: episode.store.read(name) for name in episode.store.paths()}


def named_press(found: EpisodeMetadata) -> None:
    found.task.name = "push"
    found.success = True


def test_only_the_root_changes_one_revision_later(episode: Path) -> None:
    before = content_of(episode)
    told = revise(episode, named_press, dry_run=True)
    assert content_of(episode) == before
    done = revise(episode, named_press)
    assert done == told
    assert done.changed == {"task.name": ("press", "push"), "success": (None, True)}
    after = content_of(episode)
    assert {name for name in before if before[name] != after[name]} == {"zarr.json"}
    assert list(before) == list(after)
    with open_episode(episode) as found:
        assert (found.metadata.revision, found.metadata.task.name) == (2, "push")
    assert validate(episode).problems == ()
    # The same again is no change.
    assert revise(episode, named_press).changed == {}
    assert content_of(episode) == after


def test_a_zip_is_packed_as_ever(tmp_path: Path) -> None:
    folder = write_episode(tmp_path / "one.zarr")
    packed = pack(folder)
    revise(packed, named_press)
    revise(folder, named_press)
    assert packed.read_bytes() == pack(folder, tmp_path / "again.zarr.zip").read_bytes()


def test_what_breaks_the_standard_is_never_written(
    episode: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content_of(episode)
    monkeypatch.setattr(revising, "episode_root_document", lambda _: b'{"zarr_format": 3}')
    with pytest.raises(MetadataError):
        revise(episode, named_press)
    assert content_of(episode) == before


def test_unknown_keys_of_a_newer_version_stay(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "one.zarr")

    def newer(document: dict[str, dict[str, dict[str, object]]]) -> None:
        document["attributes"]["exumi"] |= {"version": "1.9", "mood": "good"}

    edit_json(path / "zarr.json", newer)
    revise(path, named_press)
    with open_episode(path) as found:
        assert found.metadata.model_extra == {"mood": "good"}
        assert found.metadata.success is True


def test_ratings() -> None:
    found = metadata(
        quality=[
            QualityNote(code="torn", message="a", severity="info"),
            QualityNote(code="torn", message="b", stream="tactile"),
            QualityNote(code="late", message="c"),
        ]
    )
    rate(found, Rating(success=False, is_judged=True, notes={"torn": "new", "wet": "d"}))
    assert found.success is False
    assert [(note.code, note.message, note.stream) for note in found.quality] == [
        ("torn", "b", "tactile"),
        ("late", "c", None),
        ("torn", "new", None),
        ("wet", "d", None),
    ]
    assert found.quality[2].severity == "info"
    rate(found, Rating(without=("torn", "late")))
    assert [note.code for note in found.quality] == ["wet"]
    assert found.success is False
    rate(found, Rating(is_judged=True))
    assert found.success is None


def test_labels_of_a_person_replace_a_persons() -> None:
    def label(value: float, provenance: str) -> Label:
        return Label.model_validate(
            {"property": "hardness", "value": value, "provenance": provenance}
        )

    found = metadata(annotations=Annotations(labels=[label(3.0, "human"), label(4.0, "model")]))
    new = parse_label("hardness=7:0..10")
    relabel(found, {"object_id": "mug", "trial": 2}, labels=(new,))
    assert found.annotations is not None
    assert found.annotations.labels == [label(4.0, "model"), new]
    assert (found.annotations.object_id, found.annotations.trial) == ("mug", 2)
    relabel(found, {"object_id": None, "instruction": "press it"}, without_labels=("hardness",))
    assert found.annotations.labels == []
    assert found.annotations.object_id is None
    assert found.task.instruction == "press it"


def test_nothing_to_take_away_adds_no_annotations() -> None:
    found = metadata()
    relabel(found, {"object_id": None}, without_labels=("hardness",))
    assert found.annotations is None


def test_what_every_episode_has_cannot_be_taken_away() -> None:
    with pytest.raises(UsageError, match="task, licence"):
        relabel(metadata(), {"task": None, "licence": None, "object": None})


@pytest.mark.parametrize(
    ("text", "value", "scale"),
    [
        ("hardness=7:0..10", 7.0, [0.0, 10.0]),
        ("hardness=7", 7.0, None),
        ("material=wood: oak", "wood: oak", None),
    ],
)
def test_labels_as_they_are_typed(text: str, value: float | str, scale: list[float] | None) -> None:
    found = parse_label(text)
    assert (found.value, found.scale, found.raters, found.provenance) == (value, scale, 1, "human")


@pytest.mark.parametrize(
    "text", ["hardness", "=7", "hardness=", "a=7:10..0", "a=x:0..1", "a=1:0..x", "a=70:0..10"]
)
def test_what_is_no_label(text: str) -> None:
    with pytest.raises(UsageError, match=r"hardness=7:0\.\.10"):
        parse_label(text)
