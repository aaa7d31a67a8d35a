"""Many clips against one session: what the certain ones tell of the doubtful ones."""

import numpy as np
import pytest

from exumi_data.synchronisation.matching import Candidate, CommonClock, Match, match_clips
from exumi_data.synchronisation.motion import Turning
from exumi_recorders.attach.missing import skipped_numbers, uncovered
from tests.exumi_data.synchronisation.test_placing import clip_of, hand, session_of

DAY_S = 86_400.0
LENGTH_S = 6.0
STARTS_S = (5.0, 25.0, 45.0, 65.0, 85.0)


def candidate(
    number: int,
    start_s: float,
    truth: tuple[np.ndarray, np.ndarray],
    *,
    ahead_s: float = DAY_S - 50.0,
    noise: float = 0.01,
) -> Candidate:
    return Candidate(
        name=f"GX01{number:04d}.MP4",
        turning=clip_of(truth, start_s, LENGTH_S, noise=noise),
        start_ns=0,
        stop_ns=round(LENGTH_S * 1e9),
        clock_s=(start_s + ahead_s) % DAY_S,
        number=(number, 1),
    )


@pytest.fixture(scope="module")
def truth() -> tuple[np.ndarray, np.ndarray]:
    return hand(110.0)


def candidates(truth: tuple[np.ndarray, np.ndarray]) -> list[Candidate]:
    return [candidate(n + 1, start, truth) for n, start in enumerate(STARTS_S)]


def starts(matches: list[Match]) -> list[float | None]:
    return [None if m.placement is None else round(m.start_ns * 1e-9, 1) for m in matches]


def test_all_are_placed_and_their_clock_is_known_across_midnight(
    truth: tuple[np.ndarray, np.ndarray],
) -> None:
    matches, clock = match_clips(session_of(truth), candidates(truth))
    assert starts(matches) == list(STARTS_S)
    assert all(not match.doubts and not match.again for match in matches)
    assert clock is not None
    assert clock.clips == 5
    assert clock.ahead_s == pytest.approx(DAY_S - 50.0, abs=0.01)


def test_clocks_that_do_not_agree_are_no_clock(truth: tuple[np.ndarray, np.ndarray]) -> None:
    clips = [candidate(n + 1, start, truth, ahead_s=20.0 * n) for n, start in enumerate(STARTS_S)]
    matches, clock = match_clips(session_of(truth), clips)
    assert clock is None
    assert starts(matches) == list(STARTS_S)


def test_one_clock_that_is_wrong_is_a_doubt(truth: tuple[np.ndarray, np.ndarray]) -> None:
    clips = candidates(truth)
    clips[2] = candidate(3, STARTS_S[2], truth, ahead_s=0.0)
    matches, clock = match_clips(session_of(truth), clips)
    assert starts(matches) == list(STARTS_S)
    assert clock is not None
    assert clock.clips == 4
    assert [bool(match.doubts) for match in matches] == [False, False, True, False, False]
    assert "50.0 s later" in matches[2].doubts[0]


def repeated() -> tuple[np.ndarray, np.ndarray]:
    """A hand that does the same at 5 s and at 65 s."""
    time_s, values = hand(110.0)
    values = values.copy()
    values[64_000:73_000] = values[4_000:13_000]
    return time_s, values


def test_what_was_done_twice_is_told_apart_by_the_clock() -> None:
    truth = repeated()
    clips = candidates(truth)[:3]
    clips += [candidate(4, 65.0, truth), candidate(5, 85.0, truth)]
    matches, clock = match_clips(session_of(truth), clips)
    assert clock is not None
    assert starts(matches) == list(STARTS_S)
    assert [match.again for match in matches] == [True, False, False, True, False]
    assert "near its time by the camera's clock" in matches[0].doubts[0]


def test_what_was_done_twice_is_not_guessed_without_a_clock() -> None:
    truth = repeated()
    clips = [candidate(n + 1, start, truth, ahead_s=20.0 * n) for n, start in enumerate(STARTS_S)]
    matches, clock = match_clips(session_of(truth), clips)
    assert clock is None
    assert starts(matches) == [None, 25.0, 45.0, None, 85.0]
    assert "no place stands out" in matches[0].reason


def test_a_clip_of_another_hand_is_refused(truth: tuple[np.ndarray, np.ndarray]) -> None:
    other = hand(110.0, seed=9)
    clips = [*candidates(truth), candidate(6, 40.0, other)]
    matches, _ = match_clips(session_of(truth), clips)
    assert starts(matches) == [*STARTS_S, None]
    assert matches[5].reason


def test_a_copy_does_not_get_a_place_of_its_own(truth: tuple[np.ndarray, np.ndarray]) -> None:
    clips = [*candidates(truth), candidate(9, STARTS_S[1], truth)]
    matches, _ = match_clips(session_of(truth), clips)
    refused = [match for match in matches if match.placement is None]
    assert len(refused) == 1
    assert "its place is that of" in refused[0].reason


def test_another_order_than_the_cameras_is_a_doubt(
    truth: tuple[np.ndarray, np.ndarray],
) -> None:
    clips = candidates(truth)
    swapped = [
        candidate(n, start, truth) for n, start in zip((1, 2, 9, 4, 5), STARTS_S, strict=True)
    ]
    assert not any(match.doubts for match in match_clips(session_of(truth), clips)[0])
    doubts = [match.doubts for match in match_clips(session_of(truth), swapped)[0]]
    assert [bool(one) for one in doubts] == [False, False, True, False, False]
    assert "order" in doubts[2][0]


def test_clips_without_gyroscope_and_sessions_without_motion(
    truth: tuple[np.ndarray, np.ndarray],
) -> None:
    silent = Candidate(name="a.mp4", turning=None, start_ns=0, stop_ns=10**9)
    (match,), _ = match_clips(session_of(truth), [silent])
    assert "no gyroscope" in match.reason
    empty = Turning(np.empty(0, np.int64), np.empty(0))
    (match,), _ = match_clips(empty, candidates(truth)[:1])
    assert match.placement is None
    assert match_clips(session_of(truth), []) == ([], None)


def test_a_clock_that_is_known_decides_where_clips_do_not(
    truth: tuple[np.ndarray, np.ndarray],
) -> None:
    speed = truth[1].copy()
    speed[50_000:58_000] = speed[20_000:28_000]  # the same motion twice
    twice = (truth[0], speed)
    clip = candidate(1, 50.5, twice)
    (match,), clock = match_clips(session_of(twice), [clip])
    assert match.placement is None
    assert clock is None
    known = CommonClock(ahead_s=DAY_S - 52.0, scatter_s=2.0, clips=0)
    (match,), clock = match_clips(session_of(twice), [clip], None, known)
    assert starts([match]) == [50.5]
    assert clock is known


def test_the_common_clock_counts_from_midnight_to_midnight() -> None:
    clock = CommonClock(ahead_s=DAY_S - 5.0, scatter_s=0.05, clips=3)
    assert clock.away_s(1.0, np.array([6_000_000_000])).tolist() == pytest.approx([0.0])
    assert clock.away_s(0.0, np.array([6_000_000_000])).tolist() == pytest.approx([-1.0])
    assert clock.window_s == 1.0


def test_stretches_without_a_clip(truth: tuple[np.ndarray, np.ndarray]) -> None:
    quiet = truth[1].copy()
    for start, stop in (
        (0.0, 4.5),
        (11.5, 24.5),
        (31.5, 44.5),
        (51.5, 64.5),
        (71.5, 84.5),
        (91.5, 110.0),
    ):
        quiet[int(start * 1000) : int(stop * 1000)] *= 0.05
    still_between = (truth[0], quiet)
    session = session_of(still_between)
    clips = candidates(still_between)
    matches, _ = match_clips(session, clips)
    assert uncovered(session, matches) == []
    assert skipped_numbers(matches) == []
    matches, _ = match_clips(session, [*clips[:2], *clips[3:]])
    (found,) = uncovered(session, matches)
    assert found.start_s == pytest.approx(31.0, abs=0.1)
    assert found.stop_s == pytest.approx(65.0, abs=0.1)
    assert skipped_numbers(matches) == [3]
    # Pauses in which the hand is busy are no clips that are missing.
    busy = session_of(truth)
    matches, _ = match_clips(busy, candidates(truth))
    assert [stretch.start_s for stretch in uncovered(busy, matches)] == [
        pytest.approx(91.0, abs=0.1)
    ]
    assert uncovered(session, []) == []
    assert skipped_numbers([]) == []
