"""How well clips without a gyroscope are placed by the sweep that they show: simulated sessions.

Each session holds demonstrations and twelve sweeps of 12 s at six rates, the hand held another way
in each; 1.5 mm of noise on the marker, 15 % of the frames missing, exposure and readout that the
search does not know. As many sweeps of other sessions, at the same rates, must be refused.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from exumi_data.geometry import compose
from exumi_data.simulation.demonstrations import simulate_demonstrations
from exumi_data.simulation.sweep import SimulatedSweep, SweepSettings
from exumi_data.synchronisation.placing import Placement
from exumi_data.synchronisation.sweep import PoseTrack
from exumi_data.synchronisation.sweep_search import place_sweep
from exumi_data.synchronisation.timing import EXPOSURE_RANGE_S, READOUT_RANGE_S

__all__ = ["Session", "main", "simulate"]

_RATES_HZ = (0.3, 0.5, 0.8, 1.0, 1.5, 2.0)
_SWEEPS = 12
_EDGE_S, _SWEEP_S = 1.0, 12.0
_POSE_HZ, _JITTER_S, _NOISE_M = 90.0, 3e-4, 3e-4


class Session:
    """Poses of a session, in memory.

    Parameters
    ----------
    time_ns : (N,) int64
    poses : (N, 7) float64
    """

    def __init__(self, time_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> None:
        self._time_ns, self._poses = time_ns, poses

    @property
    def span_ns(self) -> tuple[int, int]:
        """Time of the first and of the last pose."""
        return int(self._time_ns[0]), int(self._time_ns[-1])

    def between(self, start_ns: int, stop_ns: int) -> PoseTrack:
        """Return the poses with ``start_ns <= time_ns < stop_ns``."""
        first, last = np.searchsorted(self._time_ns, [start_ns, stop_ns])
        return PoseTrack(self._time_ns[first:last], self._poses[first:last])


def _sweep(number: int, seed: int, rng: np.random.Generator) -> SimulatedSweep:
    settings = SweepSettings(
        rate_hz=_RATES_HZ[number % len(_RATES_HZ)],
        exposure_s=float(rng.uniform(*EXPOSURE_RANGE_S)),
        readout_s=float(rng.uniform(*READOUT_RANGE_S)),
    )
    return SimulatedSweep(settings, seed)


def simulate(
    seed: int, seconds: float
) -> tuple[Session, list[tuple[float, SimulatedSweep]], list[SimulatedSweep]]:
    """Simulate a session.

    Parameters
    ----------
    seed : int
    seconds : float

    Returns
    -------
    Session
    list of (float, SimulatedSweep)
        When each of its sweeps begins, seconds, and the sweep.
    list of SimulatedSweep
        Those of other sessions.
    """
    rng = np.random.default_rng((seed, 3))
    count = round(seconds * _POSE_HZ)
    time_s = np.sort(np.arange(count) / _POSE_HZ + _JITTER_S * rng.standard_normal(count))
    hand = simulate_demonstrations(int(seconds / 11) + 1, seed=seed)
    poses = np.concatenate([hand.pose(part) for part in np.array_split(time_s, 50)])
    own = []
    starts = np.linspace(20.0, seconds - 40.0, _SWEEPS) + rng.uniform(0.0, 3.0, _SWEEPS)
    for number, start in enumerate(starts.tolist()):
        sweep = _sweep(number, 1000 * seed + number, rng)
        inside = (time_s >= start - _EDGE_S) & (time_s < start + _SWEEP_S + _EDGE_S)
        table = np.concatenate([rng.uniform(-1, 1, 3), Rotation.random(random_state=rng).as_quat()])
        poses[inside] = compose(table, sweep.poses(time_s[inside] - start))
        own.append((start, sweep))
    poses[:, :3] += _NOISE_M * rng.standard_normal((count, 3))
    foreign = [_sweep(number, 1000 * seed + 500 + number, rng) for number in range(_SWEEPS)]
    return Session(np.rint(1e9 * time_s).astype(np.int64), poses), own, foreign


def main() -> None:
    """Simulate, place, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sessions", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=1800.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    errors, sigmas, spent = [], [], []
    refused, accepted = 0, 0
    for seed in range(options.sessions):
        session, own, foreign = simulate(seed, options.seconds)
        for start, sweep in own:
            began = time.perf_counter()
            found = place_sweep(session, sweep.marker_track())
            spent.append(time.perf_counter() - began)
            if not isinstance(found, Placement):
                refused += 1
                continue
            errors.append(1e-9 * found.offset_ns - start)
            sigmas.append(float(np.hypot(found.sigma_s, found.camera_sigma_s)))
        accepted += sum(
            isinstance(place_sweep(session, sweep.marker_track()), Placement) for sweep in foreign
        )
    error_ms, sigma_ms = 1e3 * np.array(errors), 1e3 * np.array(sigmas)
    results: dict[str, Any] = {
        "machine": describe_machine(("numpy", "scipy")),
        "sessions": options.sessions,
        "session_s": options.seconds,
        "clips": options.sessions * _SWEEPS,
        "refused": refused,
        "foreign": options.sessions * _SWEEPS,
        "foreign_accepted": accepted,
        "bias_ms": round(float(error_ms.mean()), 2),
        "rms_ms": round(float(np.sqrt(np.mean(error_ms**2))), 2),
        "largest_ms": round(float(np.abs(error_ms).max()), 2),
        "stated_sigma_ms": round(float(np.median(sigma_ms)), 2),
        "within_2_sigma": round(float(np.mean(np.abs(error_ms) <= 2 * sigma_ms)), 4),
        "search_s": round(float(np.median(spent)), 2),
    }
    print(
        "| clips | refused | foreign | accepted | bias ms | RMS ms | largest ms | stated ms |\n"
        "|---|---|---|---|---|---|---|---|\n"
        f"| {results['clips']} | {refused} | {results['foreign']} | {accepted} | "
        f"{results['bias_ms']} | {results['rms_ms']} | {results['largest_ms']} | "
        f"{results['stated_sigma_ms']} |"
    )
    report("attach_sweeps", results, options.json)


if __name__ == "__main__":
    main()
