"""The index as users meet it: build, ask, teach, forget, refuse."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exumi_data
from exumi_data.errors import (
    DamagedDataError,
    MetadataError,
    NotAnEpisodeError,
    UnsupportedError,
    UsageError,
)
from exumi_loaders.retrieval.building import Embedding
from exumi_loaders.retrieval.index import TactileIndex
from exumi_loaders.texture import TextureEncoder
from tests.exumi_loaders.retrieval.gratings import PERIODS, REST, pressed


def test_a_clip_finds_its_own_part(index: TactileIndex) -> None:
    assert len(index) == 12
    for part, period in enumerate(PERIODS):
        (best, *_) = index.query(pressed(period, 900 + part), REST, unique="part")
        assert best.entry.part_id == f"part_{part}"
        assert best.name == f"a comb {part // 2}"
        assert best.adjectives == ("ribbed", f"p{period}")
        assert best.entry.labels == {"hardness": part, "roughness": 9 - part}
        assert 0.3 < best.similarity <= 1


def test_what_is_unique_is_named_once(index: TactileIndex) -> None:
    frames = pressed(PERIODS[0], 7)
    objects = index.query(frames, REST, k=12)
    assert sorted(match.name for match in objects) == ["a comb 0", "a comb 1", "a comb 2"]
    assert sum(match.matches for match in objects) <= 12
    assert len(index.query(frames, REST, k=12, unique="part")) == 6
    clips = index.query(frames, REST, k=20, unique="clip")
    assert len({match.entry.id for match in clips}) == 12
    similarities = [match.similarity for match in clips]
    assert similarities == sorted(similarities, reverse=True)


def test_the_line_names_the_ranking_that_it_used(index: TactileIndex) -> None:
    frames = pressed(PERIODS[0], 7)
    by_similarity = index.query(frames, REST, k=1)
    assert (
        index.line(by_similarity)
        == "Most similar objects (in order of decreasing similarity): a comb 0 (ribbed, p3)."
    )
    by_matches = index.query(frames, REST, k=1, ranking="matches", unique="part")
    line = index.line(by_matches, ranking="matches", unique="part")
    assert line.startswith(
        "Most similar parts (in order of decreasing number of matches, then of similarity): "
    )


def test_the_index_says_what_it_was_made_of(
    index: TactileIndex, gratings: exumi_data.Dataset
) -> None:
    about = index.info()
    train = gratings.select(gratings.splits["mine"].lists["train"])
    assert (about.dataset, about.split) == ("gratings", "mine/train")
    assert about.dataset_digest == train.fingerprint
    assert about.encoder_digest == TextureEncoder(1).digest
    assert (about.entries, about.objects, about.parts) == (12, 3, 6)
    assert (about.space, about.dimension) == ("half-whitening/1", 11)
    assert about.as_dict()["generation"] == 0


def test_several_processes_build_the_same(tmp_path: Path, gratings: exumi_data.Dataset) -> None:
    done = []
    one, two = (
        TactileIndex.build(
            gratings,
            path=tmp_path / str(workers),
            workers=workers,
            on_done=lambda now, total: done.append((now, total)),
        )
        for workers in (1, 2)
    )
    assert one.entries() == two.entries()
    query = [Embedding(np.ones(114, np.float32), TextureEncoder(1).digest)]
    np.testing.assert_array_equal(one.search(query, 18)[0], two.search(query, 18)[0])
    assert done[-1] == (18, 18)


def test_what_is_taught_is_found_and_can_be_forgotten(index: TactileIndex) -> None:
    lesson = [(pressed(11, seed), REST) for seed in (1, 2)]
    asked = index.embed(pressed(11, 3), REST)
    assert index.query(asked)[0].name != "a new comb"
    entry = index.teach(
        lesson, name="a new comb", adjectives=["odd"], labels={"hardness": 3}, provenance="model"
    )
    assert (entry.clips, entry.taught, entry.provenance) == (2, True, "model")
    for opened in (index, TactileIndex.open(index.path)):
        best = opened.query(asked)[0]
        assert (best.name, best.adjectives) == ("a new comb", ("odd",))
        assert best.entry == entry
        assert opened.info().taught == 1
        assert opened.holds(opened.embed(*lesson[0]).origins)
    assert index.forget("a new comb") == [entry]
    assert len(index) == 12
    assert index.query(asked)[0].name != "a new comb"
    assert not index.holds(index.embed(*lesson[0]).origins)
    with pytest.raises(UsageError, match="nothing was taught"):
        index.forget("a new comb")


def test_the_vector_of_a_lesson_is_the_average(index: TactileIndex) -> None:
    lesson = [index.embed(pressed(11, seed), REST) for seed in (1, 2, 3)]
    index.teach(lesson, name="new")
    mean = index.place(lesson).mean(axis=0)
    mean /= np.linalg.norm(mean)
    similarity, row = index.search(mean[None], 1)
    assert similarity[0, 0] == pytest.approx(1, abs=1e-5)
    assert index.entry(int(row[0, 0])).name == "new"


def test_entries_of_the_dataset_are_forgotten_only_when_asked(index: TactileIndex) -> None:
    with pytest.raises(UsageError, match="nothing was taught"):
        index.forget("a comb 0")
    assert len(index.forget("a comb 0", built=True)) == 4
    assert len(index) == 8
    assert index.info().forgotten == 4
    assert {match.name for match in index.query(pressed(PERIODS[0], 7), REST)} == {
        "a comb 1",
        "a comb 2",
    }
    for name in ("a comb 1", "a comb 2"):
        index.forget(name, built=True)
    assert index.query(pressed(PERIODS[0], 7), REST) == []
    assert index.line([]).endswith(": none.")


def test_one_entry_is_forgotten_by_its_id(index: TactileIndex) -> None:
    first = index.teach([(pressed(11, 1), REST)], name="new")
    second = index.teach([(pressed(11, 2), REST)], name="new")
    assert index.forget(entry=first.id) == [first]
    assert [entry for entry in index.entries() if entry.taught] == [second]
    with pytest.raises(UsageError, match="one of the two"):
        index.forget("new", entry=second.id)


def test_many_lessons_are_put_together(
    index: TactileIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    from exumi_loaders.retrieval import changes

    monkeypatch.setattr(changes, "_MOST_SMALL", 3)
    lesson = index.embed(pressed(11, 1), REST)
    for number in range(8):
        index.teach([lesson], name=f"new {number}")
    index.forget("new 2")
    assert len(index.document.segments) <= 5
    assert [e.name for e in index.entries() if e.taught] == [
        f"new {number}" for number in (0, 1, 3, 4, 5, 6, 7)
    ]
    assert len(list((index.path / "segments").iterdir())) <= 9


def test_embeddings_of_another_encoder_are_refused(index: TactileIndex) -> None:
    vector = np.zeros(114, np.float32)
    with pytest.raises(UsageError, match="cannot be compared"):
        index.query(Embedding(vector, TextureEncoder(3).digest))
    with pytest.raises(UsageError, match="cannot be compared"):
        index.teach([Embedding(vector, "other/1")], name="new")
    with pytest.raises(UsageError, match="cannot be compared"):
        TactileIndex.open(index.path, encoder=TextureEncoder(3))
    with pytest.raises(UsageError, match="114"):
        index.query(Embedding(np.zeros(7, np.float32), TextureEncoder(1).digest))
    with pytest.raises(UsageError, match="finite"):
        index.query(Embedding(np.full(114, np.nan, np.float32), TextureEncoder(1).digest))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"ranking": "votes"}, "invalid ranking"),
        ({"unique": "name"}, "invalid unique"),
        ({"k": 0}, "positive"),
        ({"samples": 0}, "positive"),
    ],
)
def test_options_are_checked(index: TactileIndex, options: Any, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        index.query(pressed(3, 1), REST, **options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"name": " "}, "needs a name"),
        ({"name": "x", "provenance": "me"}, "invalid provenance"),
        ({"name": "x", "labels": {"hardness": 11}}, "from 0 to 10"),
        ({"name": "x", "adjectives": ["y" * 2000]}, "letters"),
        ({"name": "x", "adjectives": ["soft", " "]}, "is empty"),
        ({"name": "x", "labels": {"": 5}}, "is empty"),
    ],
)
def test_lessons_are_checked(index: TactileIndex, options: Any, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        index.teach([(pressed(3, 1), REST)], **options)
    with pytest.raises(UsageError, match="at least one clip"):
        index.teach([], name="x")
    assert len(index) == 12


def test_a_folder_that_is_there_is_left_alone(tmp_path: Path, gratings: exumi_data.Dataset) -> None:
    (tmp_path / "mine").mkdir()
    with pytest.raises(UsageError, match="there already"):
        TactileIndex.build(gratings, path=tmp_path / "mine")
    assert list((tmp_path / "mine").iterdir()) == []


def test_a_build_that_fails_leaves_nothing(tmp_path: Path, gratings: exumi_data.Dataset) -> None:
    with pytest.raises(UsageError, match=r"stream tactile: .*made for 3"):
        TactileIndex.build(gratings, TextureEncoder(3), path=tmp_path / "index")
    with pytest.raises(UsageError, match="two clips"):
        TactileIndex.build(gratings[:1], path=tmp_path / "index")
    assert list(tmp_path.iterdir()) == []


def test_the_place_is_claimed_before_anything_is_encoded(
    tmp_path: Path, gratings: exumi_data.Dataset
) -> None:
    refused = []

    def meanwhile(_done: int, _total: int) -> None:
        with pytest.raises(UsageError, match="written by another process"):
            TactileIndex.build(gratings, path=tmp_path / "index")
        refused.append(True)

    index = TactileIndex.build(gratings, path=tmp_path / "index", on_done=meanwhile)
    assert refused
    assert len(index) == 18
    (tmp_path / "file").touch()

    def never(done: int, _total: int) -> None:
        pytest.fail(f"{done} clips were encoded for nothing")

    with pytest.raises(NotADirectoryError):
        TactileIndex.build(gratings, path=tmp_path / "file" / "index", on_done=never)


def test_an_episode_and_another_index_are_left_whole(
    index: TactileIndex, gratings: exumi_data.Dataset
) -> None:
    episode = Path(gratings.episode_location(0))
    link = index.path.with_name("link")
    link.symlink_to(episode)
    for folder in (episode, link, index.path, index.path / "segments"):
        before = sorted(folder.iterdir())
        with pytest.raises(UsageError, match="lies inside"):
            TactileIndex.build(gratings, path=folder / "index")
        assert sorted(folder.iterdir()) == before


def test_an_object_is_taught_by_as_many_clips_as_there_are(index: TactileIndex) -> None:
    lesson = index.embed(pressed(11, 1), REST)
    many = [replace(lesson, origins=(f"clip:{n}", f"pixels:{n}")) for n in range(300)]
    assert index.teach(many, name="worn out").clips == 300
    assert index.holds(["clip:299"])


def _edit(path: Path, **changed: Any) -> None:
    document = json.loads((path / "index.json").read_text())
    (path / "index.json").write_text(json.dumps({**document, **changed}))


def test_what_is_no_index_is_refused(tmp_path: Path, index: TactileIndex) -> None:
    with pytest.raises(NotAnEpisodeError, match=r"no index\.json"):
        TactileIndex.open(tmp_path / "none")
    _edit(index.path, version="2.0")
    with pytest.raises(UnsupportedError, match=r"2\.0"):
        TactileIndex.open(index.path)
    _edit(index.path, version="1.0", more=1)
    with pytest.raises(MetadataError):
        TactileIndex.open(index.path)
    with pytest.raises(UsageError, match="invalid backend"):
        TactileIndex.open(index.path, backend="hnsw")  # type: ignore[arg-type]  # on purpose


def test_an_index_cannot_ask_for_more_than_its_files_hold(index: TactileIndex) -> None:
    """Numbers in the documents alone cost no memory."""
    segment = index.document.segments[0]
    _edit(index.path, segments=[{"name": segment.name, "rows": 2**31, "crc32c": []}])
    with pytest.raises(DamagedDataError, match="expected"):
        TactileIndex.open(index.path)
    array = index.path / "segments" / segment.name / "embeddings" / "zarr.json"
    document = json.loads(array.read_text())
    document["shape"][0] = 2**31
    document["chunk_grid"]["configuration"]["chunk_shape"][0] = 2**31
    document["codecs"][0]["configuration"]["chunk_shape"][0] = 2**10
    array.write_text(json.dumps(document))
    with pytest.raises(DamagedDataError, match="cut short"):
        TactileIndex.open(index.path)


def test_an_index_cannot_ask_for_memory_by_its_number_of_frames(index: TactileIndex) -> None:
    for frames in (0, 10**9, 10**30):
        _edit(index.path, frames=frames)
        with pytest.raises(MetadataError, match=r"\$\.frames"):
            TactileIndex.open(index.path)


@pytest.mark.parametrize("name", ["mean", "matrix"])
def test_a_flipped_bit_of_the_space_is_found(index: TactileIndex, name: str) -> None:
    """It would shift all similarities a little, and nothing else would tell."""
    file = index.path / "space" / name / "c" / "0" / "0"
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0x10
    file.write_bytes(content)
    with pytest.raises(DamagedDataError):
        TactileIndex.open(index.path)


@pytest.mark.parametrize("victim", ["embeddings", "entries.parquet", "space", "zarr"])
def test_damage_is_named(index: TactileIndex, victim: str) -> None:
    segment = index.path / "segments" / index.document.segments[0].name
    if victim == "embeddings":
        (segment / "embeddings" / "c" / "0" / "0").write_bytes(b"short")
    elif victim == "entries.parquet":
        (segment / "entries.parquet").write_bytes(b"PAR1 no table PAR1")
    elif victim == "zarr":
        (segment / "embeddings" / "zarr.json").unlink()
    else:
        shutil.rmtree(index.path / "space")
    with pytest.raises(DamagedDataError):
        TactileIndex.open(index.path)


def test_any_zarr_reader_opens_it(index: TactileIndex) -> None:
    import zarr

    name = index.document.segments[0].name
    group = zarr.open_group(index.path / "segments" / name, mode="r")
    vectors = np.asarray(group["embeddings"])
    assert vectors.shape == (12, 11)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
