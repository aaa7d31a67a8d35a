"""One clip against a session: where it is, how it drifts, and when it is not to be believed."""

from fractions import Fraction

import numpy as np
import pytest

from exumi_data.synchronisation.motion import Turning
from exumi_data.synchronisation.placing import SessionCurve, place, still


def hand(seconds: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Time in seconds at 1 kHz, and how fast a hand turns that moves as hands do."""
    time_s = np.arange(int(seconds * 1000)) * 1e-3
    rng = np.random.default_rng(seed)
    waves = [
        rng.uniform(0.2, 1.0) * np.sin(2 * np.pi * (rng.uniform(0.1, 2.5) * time_s + rng.uniform()))
        for _ in range(12)
    ]
    return time_s, np.abs(np.sum(waves, axis=0))


def sampled_at(seconds: np.ndarray, of: tuple[np.ndarray, np.ndarray], noise: float) -> np.ndarray:
    rng = np.random.default_rng(len(seconds))
    return np.asarray(np.interp(seconds, *of) + rng.normal(0.0, noise, len(seconds)))


def session_of(truth: tuple[np.ndarray, np.ndarray], noise: float = 0.03) -> Turning:
    time_s = np.arange(0.0, truth[0][-1], 1 / 90) + 0.003
    return Turning(np.rint(1e9 * time_s).astype(np.int64), sampled_at(time_s, truth, noise))


def clip_of(
    truth: tuple[np.ndarray, np.ndarray],
    start_s: float,
    seconds: float,
    *,
    drift_ppm: float = 0.0,
    noise: float = 0.01,
) -> Turning:
    time_s = np.arange(0.0, seconds, 1 / 200)
    true_s = start_s + time_s / (1.0 + 1e-6 * drift_ppm)
    return Turning(np.rint(1e9 * time_s).astype(np.int64), sampled_at(true_s, truth, noise))


@pytest.mark.parametrize("start_s", [0.0, 17.3331, 52.0])
def test_a_clip_is_found_to_a_millisecond(start_s: float) -> None:
    truth = hand(60.0)
    session, clip = session_of(truth), clip_of(truth, start_s, 8.0)
    fit = SessionCurve(session, 8.0).fit(clip)
    assert fit is not None
    assert abs(fit.offset_ns * 1e-9 - start_s) <= 0.02
    assert fit.correlation > 0.97
    assert fit.distinct > 3
    found = place(session, clip, fit.offset_ns)
    assert found is not None
    assert found.to_session(0) * 1e-9 == pytest.approx(start_s, abs=1.5e-3)
    assert abs(found.to_session(0) * 1e-9 - start_s) < 4 * found.sigma_s + 1e-4
    assert found.agrees
    assert found.drift_sigma_ppm is None


def test_a_clip_that_began_before_the_session() -> None:
    truth = hand(40.0)
    session, clip = session_of(truth).between(10 * 10**9, 40 * 10**9), clip_of(truth, 8.0, 9.0)
    fit = SessionCurve(session, 9.0).fit(clip)
    assert fit is not None
    assert abs(fit.offset_ns * 1e-9 - 8.0) <= 0.02


@pytest.mark.parametrize("drift_ppm", [43.0, -43.0])
def test_drift_is_found_in_a_long_clip(drift_ppm: float) -> None:
    truth = hand(400.0)
    session = session_of(truth)
    clip = clip_of(truth, 20.0, 300.0, drift_ppm=drift_ppm)
    found = place(session, clip, round(20.01e9))
    assert found is not None
    assert found.agrees
    assert found.drift_sigma_ppm is not None
    # The session's clock is slower by as much as the clip's is faster.
    assert found.drift_ppm == pytest.approx(-drift_ppm, abs=4 * found.drift_sigma_ppm)
    for clip_s in (0.0, 150.0, 300.0):
        true_s = 20.0 + clip_s / (1.0 + 1e-6 * drift_ppm)
        assert found.to_session(round(clip_s * 1e9)) * 1e-9 == pytest.approx(true_s, abs=1e-3)
    exact = Fraction(found.drift_ppm) / 10**6
    at = 123_456_789_012
    wanted = at + found.offset_ns + round((at - found.t_ref_ns) * exact)
    assert abs(found.to_session(at) - wanted) <= 1


def test_a_clip_with_a_jump_in_it_does_not_agree_with_itself() -> None:
    truth = hand(60.0)
    clip = clip_of(truth, 10.0, 30.0)
    later = clip_of(truth, 10.03, 30.0)
    half = len(clip.time_ns) // 2
    torn = Turning(clip.time_ns, np.concatenate([clip.rad_per_s[:half], later.rad_per_s[half:]]))
    whole, broken = (place(session_of(truth), one, round(10e9)) for one in (clip, torn))
    assert whole is not None
    assert whole.agrees
    assert broken is None or not broken.agrees


def test_a_tracker_that_jumps_does_not_hide_the_motion() -> None:
    truth = hand(60.0)
    session, clip = session_of(truth), clip_of(truth, 20.0, 8.0)
    jumped = session.rad_per_s.copy()
    inside = np.flatnonzero((session.time_ns > 21 * 10**9) & (session.time_ns < 27 * 10**9))
    for at in inside[::270]:
        jumped[at : at + 5] = 18.0
    broken = Turning(session.time_ns, jumped)
    fit = SessionCurve(broken, 8.0).fit(clip)
    assert fit is not None
    assert fit.correlation > 0.9
    found = place(broken, clip, fit.offset_ns)
    assert found is not None
    assert found.to_session(0) * 1e-9 == pytest.approx(20.0, abs=5e-3)


def test_another_hand_does_not_stand_out() -> None:
    session = session_of(hand(300.0))
    for seed in range(1, 6):
        fit = SessionCurve(session, 8.0).fit(clip_of(hand(20.0, seed), 2.0, 8.0))
        assert fit is not None
        assert fit.correlation < 0.9
        assert fit.distinct < 3


def test_where_it_may_lie_can_be_limited() -> None:
    truth = hand(60.0)
    session, clip = session_of(truth), clip_of(truth, 20.0, 6.0)
    curve = SessionCurve(session, 6.0)
    fit = curve.fit(clip, lambda offset_ns: offset_ns > 30 * 10**9)
    assert fit is not None
    assert fit.offset_ns > 30 * 10**9
    assert curve.fit(clip, lambda offset_ns: offset_ns > 10**15) is None


def test_clips_that_say_nothing() -> None:
    truth = hand(20.0)
    assert still(clip_of(truth, 2.0, 8.0)) is None
    assert "shorter" in str(still(clip_of(truth, 2.0, 1.5)))
    quiet = Turning(np.arange(0, 8 * 10**9, 5 * 10**6), np.full(1600, 0.01))
    assert "hardly turns" in str(still(quiet))
    empty = Turning(np.empty(0, np.int64), np.empty(0))
    assert "shorter" in str(still(empty))
