"""Scores: what is counted, what is refused, how sure it is."""

import numpy as np
import pytest

import exumi_data
from exumi_data.errors import UsageError
from exumi_data.model import EpisodeMetadata, Source, Task
from exumi_data.model.description import InputFile
from exumi_loaders.retrieval.building import EncodedClips, encode_clips
from exumi_loaders.retrieval.entries import Entry
from exumi_loaders.retrieval.guessing import guessing_game
from exumi_loaders.retrieval.identities import frames_identity, identities
from exumi_loaders.retrieval.index import TactileIndex
from exumi_loaders.retrieval.matches import rank
from exumi_loaders.retrieval.scoring import clustered, evaluate, leave_one_out
from exumi_loaders.retrieval.space import fit_space, unit
from exumi_loaders.texture import TextureEncoder
from tests.exumi_loaders.retrieval.gratings import REST, pressed

GREY = TextureEncoder(1)


@pytest.fixture(scope="module")
def encoded(gratings: exumi_data.Dataset) -> EncodedClips:
    return encode_clips(gratings, GREY)


def test_clips_of_another_split_are_scored(
    index: TactileIndex, gratings: exumi_data.Dataset
) -> None:
    test = gratings.select(gratings.splits["mine"].lists["test"])
    scores = {(s.by, s.ranking): s for s in evaluate(index, encode_clips(test, GREY))}
    assert list(scores) == [
        ("part", "similarity"),
        ("part", "matches"),
        ("object", "similarity"),
        ("object", "matches"),
    ]
    best = scores["part", "similarity"]
    assert (best.queries, best.groups, best.known) == (6, 6, 6)
    assert best.first.value >= 5 / 6
    assert best.first.low <= best.first.value <= best.first.high
    assert best.five.value == 1
    assert scores["object", "matches"].groups == 3


def test_what_the_index_does_not_know_counts_as_not_found(
    index: TactileIndex, gratings: exumi_data.Dataset
) -> None:
    test = encode_clips(gratings.select(gratings.splits["mine"].lists["test"]), GREY)
    index.forget("a comb 1", built=True)
    (score, *_) = evaluate(index, test)
    assert (score.queries, score.known) == (6, 4)
    assert score.five.value == pytest.approx(4 / 6)


def test_a_query_that_is_in_the_index_is_refused(
    index: TactileIndex, encoded: EncodedClips
) -> None:
    with pytest.raises(UsageError, match="holds 12 of 18 queries"):
        evaluate(index, encoded)


def test_what_was_taught_is_in_the_index_and_what_was_forgotten_of_a_build_still_is(
    index: TactileIndex, gratings: exumi_data.Dataset
) -> None:
    test = encode_clips(gratings.select(gratings.splits["mine"].lists["test"]), GREY)
    index.teach([test.embedding(0)], name="new")
    with pytest.raises(UsageError, match="holds 1 of 6"):
        evaluate(index, test)
    index.forget("new")
    assert evaluate(index, test)
    train = encode_clips(gratings.select(gratings.splits["mine"].lists["train"][:1]), GREY)
    index.forget(train.entries[0].name, built=True)
    with pytest.raises(UsageError, match="holds 1 of 1"):
        evaluate(index, train)


def test_clips_are_told_by_their_origin_and_by_their_pixels(index: TactileIndex) -> None:
    frames = pressed(3, 1)  # the second clip of part 0, under no id
    assert index.holds(index.embed(frames, REST).origins)
    changed = frames.copy()
    changed[0, 0, 0] ^= 1
    assert not index.holds(index.embed(changed, REST).origins)
    assert frames_identity(frames, REST) != frames_identity(frames, None)


def test_a_prepared_clip_is_told_by_its_parent_and_its_source() -> None:
    def known(number: int, **source: object) -> set[str]:
        metadata = EpisodeMetadata(
            id=f"00000000-0000-0000-0000-00000000000{number}",
            task=Task(name="touch"),
            regime="touch",
            licence="CC0-1.0",
            source=Source(type="converted", tool="t", tool_version="1", **source),  # type: ignore[arg-type]  # fields by name
        )
        return set(identities(metadata, "tactile"))

    parent = "00000000-0000-0000-0000-000000000001"
    assert known(1) & known(2, parent_id=parent)
    film = InputFile(name="a.mov", sha256="0" * 64)
    assert known(1, key="a", inputs=[film]) & known(2, key="a", inputs=[film])
    # One file can hold many episodes.
    assert not known(1, key="a", inputs=[film]) & known(2, key="b", inputs=[film])


def test_leaving_one_out_equals_an_index_without_it(
    encoded: EncodedClips, gratings: exumi_data.Dataset, tmp_path_factory: pytest.TempPathFactory
) -> None:
    told: list[tuple[int, int]] = []
    (score, *_) = leave_one_out(encoded, GREY, on_done=lambda *now: told.append(now))
    right = 0
    for number in (0, 7, 16):
        others = [n for n in range(len(encoded)) if n != number]
        path = tmp_path_factory.mktemp("without") / "index"
        index = TactileIndex.build(gratings.select([gratings.ids[n] for n in others]), path=path)
        best = index.query(encoded.embedding(number), unique="part")[0]
        right += best.entry.part_id == encoded.entries[number].part_id
    assert right == 3
    assert score.first.value > 0.8
    assert score.known == 18
    by_part = sorted(range(18), key=lambda number: encoded.entries[number].part_id or "")[:4]
    few = [encoded.entries[number] for number in by_part]  # three of one part, one of another
    left = leave_one_out(EncodedClips(encoded.vectors[by_part], few, encoded.encoder), GREY)
    assert left[0].known == 3
    assert told[-1] == (18, 18)
    with pytest.raises(UsageError, match="not by"):
        leave_one_out(encoded, TextureEncoder(3))


def test_nothing_is_scored_where_nothing_is_known(index: TactileIndex) -> None:
    vectors = np.random.default_rng(0).normal(size=(3, 114)).astype(np.float32)
    clips = EncodedClips(vectors, [Entry(f"x{n}/t", "x") for n in range(3)], GREY.digest)
    with pytest.raises(UsageError, match="part or object ids"):
        evaluate(index, clips)


def test_the_two_rankings_differ_where_they_should() -> None:
    groups = np.array([4, 7, 7, 2, 2, 2])
    similarity = np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.4])
    first, matches = rank(groups, similarity, "similarity")
    assert (first.tolist(), matches.tolist()) == ([0, 1, 3], [1, 2, 3])
    first, matches = rank(groups, similarity, "matches")
    assert (first.tolist(), matches.tolist()) == ([3, 1, 0], [3, 2, 1])
    tied = np.array([1, 2, 2, 1])
    assert rank(tied, similarity[:4], "matches")[0].tolist() == [0, 1]


def test_intervals_widen_where_clips_of_a_part_agree() -> None:
    hits = np.repeat(np.random.default_rng(0).random(20) < 0.5, 10)
    apart = clustered(hits, np.arange(200))
    together = clustered(hits, np.repeat(np.arange(20), 10))
    assert together.value == apart.value == hits.mean()
    assert together.high - together.low > 2 * (apart.high - apart.low)
    sure = clustered(np.ones(9, bool), np.arange(9))
    assert (sure.low, sure.high) == (1, 1)


def test_a_space_whitens_half_way() -> None:
    random = np.random.default_rng(0)
    wide = random.normal(size=(4000, 3)) * (100, 1, 1) + 5
    mixed = np.concatenate((wide, wide[:, :1] + random.normal(size=(4000, 1))), axis=1)
    space = fit_space(mixed.astype(np.float32), 3)
    moved = (mixed - space.mean) @ space.matrix
    covariance = np.cov(moved.T)
    np.testing.assert_allclose(covariance - np.diag(np.diag(covariance)), 0, atol=1e-3)
    scaled = (mixed - mixed.mean(0)) / mixed.std(0)
    power = np.sort(np.linalg.eigvalsh(np.cov(scaled.T)))[::-1][:3]
    np.testing.assert_allclose(np.diag(covariance), np.sqrt(power), rtol=1e-2)
    np.testing.assert_allclose(np.linalg.norm(space.place(mixed), axis=1), 1, atol=1e-5)
    assert unit(np.zeros((1, 3))).tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("vectors", [np.zeros((1, 4)), np.ones((5, 4))])
def test_a_space_needs_clips_that_differ(vectors: np.ndarray) -> None:
    with pytest.raises(UsageError, match="two clips"):
        fit_space(vectors, 3)


def _parts(spread: float, clips: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Vectors of 20 parts, around a centre each."""
    random = np.random.default_rng(1)
    centres = np.repeat(random.normal(size=(20, 12)), clips, axis=0)
    vectors = centres + spread * random.normal(size=centres.shape)
    return vectors.astype(np.float32), np.repeat([f"p{n}" for n in range(20)], clips)


def test_a_game_is_won_by_who_can_feel_and_lost_by_who_cannot() -> None:
    vectors, parts = _parts(0.01)
    won = guessing_game(vectors, parts, whitening=8, taught=2, folds=4, rounds=2)
    assert (won.games, won.parts, won.right.value) == (160, 20, 1)
    blind = np.random.default_rng(0).normal(size=vectors.shape).astype(np.float32)
    lost = guessing_game(blind, parts, whitening=None, folds=4, rounds=6)
    assert 0.1 < lost.right.value < 0.3
    assert lost.right.low <= 0.2 <= lost.right.high
    again = guessing_game(blind, parts, whitening=None, folds=4, rounds=6)
    assert again == lost


def test_untaught_a_guess_goes_by_labels() -> None:
    vectors, parts = _parts(0.05)
    vectors[:, 0] = np.repeat(np.arange(20), 4)  # what is felt is what is rated
    labels = np.repeat(np.arange(20.0), 4)[:, None]
    vectors[:, 1:] = 0.01
    vectors[:, 1] = 20 - vectors[:, 0]
    result = guessing_game(vectors, parts, whitening=None, taught=0, labels=labels, folds=4)
    assert result.right.value > 0.5
    with pytest.raises(UsageError, match="labels"):
        guessing_game(vectors, parts, whitening=None, taught=0)
    with pytest.raises(UsageError, match="too few"):
        guessing_game(vectors, parts, whitening=None, taught=4, folds=4)
