"""How well a sweep gives the latency of poses: simulated sweeps with known truth.

12 s, 12 cm to each side, 1.5 mm of noise on the marker, 15 % of the frames missing, a true delay of
up to 300 ms either way. First a camera without readout and exposure and a headset without lag; then
exposure, readout and lag that the estimate does not know, where the poses are used with another
lag than the one they had in the sweep; then data that must be refused.
"""

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.simulation.sweep import SweepSettings, simulate_sweep
from exumi_data.synchronisation.sweep import MarkerTrack, PoseTrack, estimate_sweep
from exumi_data.synchronisation.timing import (
    EXPOSURE_RANGE_S,
    HEADSET_LAG_RANGE_S,
    READOUT_RANGE_S,
    CameraTiming,
    Range,
)

__all__ = ["RATES_HZ", "WRONG", "Outcome", "main", "run", "summary", "wrongly_accepted"]

RATES_HZ = (0.3, 0.5, 1.0, 1.5, 1.75, 2.0)
_MOST_DELAY_S = 0.3
_BASIN_S = 0.02
_PERFECT = CameraTiming(Range(0.0, 0.0), Range(0.0, 0.0))
_NO_LAG = Range(0.0, 0.0)


@dataclass(frozen=True)
class Outcome:
    """What one sweep gave.

    Attributes
    ----------
    rate_hz : float
    sweep_s : float
        Estimate less the latency that the poses had in the sweep.
    use_s : float
        Estimate less the latency that they have in use.
    sigma_s : float
        The stated standard deviation.
    refusals : tuple of str
        NaN above where nothing was estimated.
    """

    rate_hz: float
    sweep_s: float
    use_s: float
    sigma_s: float
    refusals: tuple[str, ...]


def run(seed: int, *, effects: bool) -> Outcome:
    """Simulate and estimate one sweep.

    Parameters
    ----------
    seed : int
        Its rate goes round `RATES_HZ`; the rest is drawn.
    effects : bool
        Whether there are exposure, readout and lag, none of them known.
    """
    rng = np.random.default_rng((seed, 5))
    settings = SweepSettings(
        rate_hz=RATES_HZ[seed % len(RATES_HZ)],
        delay_s=float(rng.uniform(-_MOST_DELAY_S, _MOST_DELAY_S)),
    )
    lag_in_use = 0.0
    if effects:
        settings = replace(
            settings,
            exposure_s=float(rng.uniform(*EXPOSURE_RANGE_S)),
            readout_s=float(rng.uniform(*READOUT_RANGE_S)),
            headset_lag_s=float(rng.uniform(*HEADSET_LAG_RANGE_S)),
        )
        lag_in_use = float(rng.uniform(*HEADSET_LAG_RANGE_S))
    known = {} if effects else {"camera": _PERFECT, "headset_lag_s": _NO_LAG}
    try:
        found = estimate_sweep(*simulate_sweep(settings, seed), **known)  # type: ignore[arg-type]  # two keywords of two types
    except CalibrationRefusedError as error:
        nothing = float("nan")
        return Outcome(settings.rate_hz, nothing, nothing, nothing, (str(error),))
    return Outcome(
        rate_hz=settings.rate_hz,
        sweep_s=found.latency_s - settings.delay_s - settings.headset_lag_s,
        use_s=found.latency_s - settings.delay_s - lag_in_use,
        sigma_s=found.sigma_s,
        refusals=found.refusals,
    )


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return bias, RMS and coverage of outcomes, milliseconds; refused ones are counted apart."""
    told = [o for o in outcomes if not o.refusals]
    sweep = 1e3 * np.array([o.sweep_s for o in told])
    use = 1e3 * np.array([o.use_s for o in told])
    sigma = 1e3 * np.array([o.sigma_s for o in told])
    return {
        "sweeps": len(outcomes),
        "refused": len(outcomes) - len(told),
        "bias_ms": round(float(sweep.mean()), 3),
        "rms_ms": round(float(np.sqrt(np.mean(sweep**2))), 3),
        "largest_ms": round(float(np.abs(sweep).max()), 3),
        "stated_sigma_ms": round(float(np.mean(sigma)), 3),
        "in_use_rms_ms": round(float(np.sqrt(np.mean(use**2))), 3),
        "within_2_sigma_in_sweep": round(float(np.mean(np.abs(sweep) <= 2 * sigma)), 4),
        "within_2_sigma_in_use": round(float(np.mean(np.abs(use) <= 2 * sigma)), 4),
        "largest_in_use_sigmas": round(float((np.abs(use) / sigma).max()), 2),
        "wrong_basins": int(np.sum(np.abs(sweep) > 1e3 * _BASIN_S)),
    }


Tracks = tuple[MarkerTrack, PoseTrack]


def _sweep(rate_hz: float, seed: int, **changes: Any) -> Tracks:
    return simulate_sweep(SweepSettings(rate_hz=rate_hz, **changes), seed)


def _unrelated(rate_hz: float, seed: int) -> Tracks:
    return _sweep(rate_hz, seed)[0], _sweep(1.1 * rate_hz, seed + 1)[1]


def _no_motion(rate_hz: float, seed: int) -> Tracks:
    return _sweep(rate_hz, seed, reach_m=2e-3)


def _frozen(rate_hz: float, seed: int) -> Tracks:
    marker, pose = _sweep(rate_hz, seed)
    poses = pose.poses.copy()
    poses[len(poses) // 3 :] = poses[len(poses) // 3]
    return marker, PoseTrack(pose.time_ns, poses)


def _periodic(rate_hz: float, seed: int) -> Tracks:
    return _sweep(max(rate_hz, 1.5), seed, regular=True)


def _few_detections(rate_hz: float, seed: int) -> Tracks:
    return _sweep(rate_hz, seed, missing=0.7)


def _another_time(rate_hz: float, seed: int) -> Tracks:
    marker, pose = _sweep(rate_hz, seed)
    return marker, PoseTrack(pose.time_ns + 60_000_000_000, pose.poses)


def _clock_step(rate_hz: float, seed: int) -> Tracks:
    marker, pose = _sweep(rate_hz, seed)
    middle = len(marker.time_ns) // 2
    step = np.where(np.arange(len(marker.time_ns)) < middle, 0, 20_000_000)
    return replace(marker, time_ns=marker.time_ns + step), pose


def _too_far(rate_hz: float, seed: int) -> Tracks:
    return _sweep(rate_hz, seed, delay_s=0.8)


WRONG: dict[str, Callable[[float, int], Tracks]] = {
    "no motion": _no_motion,
    "tracking frozen": _frozen,
    "periodic, fast": _periodic,
    "unrelated": _unrelated,
    "few detections": _few_detections,
    "of another time": _another_time,
    "clock steps by 20 ms": _clock_step,
    "delay beyond the range": _too_far,
}


def wrongly_accepted(seed: int, *, what: str) -> str | None:
    """Return what an estimate from wrong data said; None where it was refused."""
    marker, pose = WRONG[what](RATES_HZ[seed % len(RATES_HZ)], seed)
    try:
        found = estimate_sweep(marker, pose)
    except CalibrationRefusedError:
        return None
    return None if found.refusals else f"{what} {seed}: {1e3 * found.latency_s:.1f} ms"


def _table(by_rate: dict[str, dict[str, Any]]) -> str:
    columns = ("bias_ms", "rms_ms", "largest_ms", "stated_sigma_ms", "in_use_rms_ms")
    more = ("within_2_sigma_in_use", "wrong_basins", "refused", "sweeps")
    lines = ["| rate | " + " | ".join((*columns, *more)) + " |", "|---" * 10 + "|"]
    for rate, row in by_rate.items():
        lines.append(f"| {rate} | " + " | ".join(str(row[c]) for c in (*columns, *more)) + " |")
    return "\n".join(lines)


def main() -> None:
    """Simulate, estimate, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=504)
    parser.add_argument("--wrong", type=int, default=36, help="sweeps of each kind of wrong data")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    results: dict[str, Any] = {"machine": describe_machine(("numpy", "scipy"))}
    start = time.perf_counter()
    with ProcessPoolExecutor(options.workers) as pool:
        for name, effects in (("without_effects", False), ("with_effects", True)):
            seeds = range(options.runs)
            outcomes = list(pool.map(partial(run, effects=effects), seeds, chunksize=6))
            by_rate = {
                f"{rate:g} Hz": summary([o for o in outcomes if o.rate_hz == rate])
                for rate in RATES_HZ
            }
            by_rate["all"] = summary(outcomes)
            results[name] = by_rate
            print(f"{name}\n{_table(by_rate)}\n")
        wrong = range(options.wrong)
        results["wrong_data_accepted"] = {
            what: [said for said in pool.map(partial(wrongly_accepted, what=what), wrong) if said]
            for what in WRONG
        }
    results["wrong_data_of_each_kind"] = options.wrong
    results["seconds"] = round(time.perf_counter() - start, 1)
    report("latency_sweep", results, options.json)


if __name__ == "__main__":
    main()
