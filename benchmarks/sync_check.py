"""How well latency faults are found: simulated episodes with known truth.

Half of the tactile streams have no fault, the others one of ±20 ms or of anything up to ±120 ms;
grippers of another pace, soft objects, encoders and frame rates of several kinds, jitter, losses.
"""

import argparse
import os
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from measuring import describe_machine, report
from sync_episodes import SyncEpisode, make_episode

from exumi_data.standard import rules
from exumi_data.synchronisation import LatencyEstimate, estimate_touch_latency

__all__ = ["Outcome", "judge", "main", "summary"]

_Z95 = 1.96


@dataclass(frozen=True)
class Outcome:
    """What was found of one tactile stream, and what is true.

    Attributes
    ----------
    seed : int
    finger : str
    fault_s : float
        True latency.
    grasps : int
        Whole grasps of the episode.
    soft : bool
        Whether its objects give way.
    offset_s, sigma_s : float or None
        The estimate; None where there is none.
    found : "SYNC-001" or "SYNC-002" or None
    """

    seed: int
    finger: str
    fault_s: float
    grasps: int
    soft: bool
    offset_s: float | None
    sigma_s: float | None
    found: str | None

    @property
    def estimated(self) -> bool:
        """Whether there is an estimate."""
        return self.offset_s is not None

    @property
    def covered(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        if self.offset_s is None or self.sigma_s is None:
            return False
        return abs(self.offset_s - self.fault_s) <= _Z95 * self.sigma_s


def judge(estimate: LatencyEstimate | None) -> str | None:
    """Return the rule that a latency breaks, by the limits of the standard."""
    if estimate is None:
        return None
    for code in ("SYNC-001", "SYNC-002"):
        limits = rules()[code].limits
        if abs(estimate.offset_s) > max(limits["offset_s"], limits["sigmas"] * estimate.sigma_s):
            return code
    return None


def _outcomes(seed: int) -> list[Outcome]:
    episode: SyncEpisode = make_episode(seed)
    found = []
    for finger, curve in episode.activity.items():
        width = episode.width
        estimate = estimate_touch_latency(curve.time_ns, curve.values, width.time_ns, width.values)
        found.append(
            Outcome(
                seed=seed,
                finger=finger,
                fault_s=curve.fault_s,
                grasps=episode.grasps,
                soft=episode.soft,
                offset_s=estimate.offset_s if estimate else None,
                sigma_s=estimate.sigma_s if estimate else None,
                found=judge(estimate),
            )
        )
    return found


def _share(kept: Iterable[bool]) -> dict[str, Any]:
    values = list(kept)
    share = round(sum(values) / len(values), 4) if values else None
    return {"count": sum(values), "of": len(values), "share": share}


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return counts and shares.

    Parameters
    ----------
    outcomes : list of Outcome

    Returns
    -------
    dict
        What is not estimable although there is a whole grasp counts as not found.
    """
    events = [o for o in outcomes if o.grasps]
    estimated = [o for o in outcomes if o.estimated]
    sound = [o for o in outcomes if o.fault_s == 0]
    episodes = {o.seed for o in sound} - {o.seed for o in outcomes if o.fault_s != 0}
    alarmed = {o.seed for o in sound if o.found}
    sigmas = sorted(o.sigma_s * 1e3 for o in estimated if o.sigma_s is not None)
    errors = sorted(abs(o.offset_s - o.fault_s) * 1e3 for o in estimated if o.offset_s is not None)
    return {
        "episodes": len({o.seed for o in outcomes}),
        "streams": len(outcomes),
        "interval_covers": _share(o.covered for o in estimated),
        "interval_covers_soft": _share(o.covered for o in estimated if o.soft),
        "found_20_ms": _share(o.found is not None for o in events if abs(o.fault_s) == 0.02),
        "found_beyond_50_ms": _share(o.found is not None for o in events if abs(o.fault_s) > 0.05),
        "false_alarms": _share(o.found is not None for o in sound),
        "false_alarms_by_episode": _share(seed in alarmed for seed in episodes),
        "not_estimable_with_grasp": _share(not o.estimated for o in events),
        "not_estimable_without_grasp": _share(not o.estimated for o in outcomes if not o.grasps),
        "error_ms": {"median": errors[len(errors) // 2], "largest": errors[-1]},
        "sigma_ms": {"median": sigmas[len(sigmas) // 2], "largest": sigmas[-1]},
    }


def main() -> None:
    """Simulate, estimate, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path)
    parser.add_argument("--all", action="store_true", help="list every stream in the JSON too")
    options = parser.parse_args()
    machine = describe_machine(("numpy", "opencv-contrib-python-headless"))
    start = time.perf_counter()
    seeds = range(options.first_seed, options.first_seed + options.episodes)
    with ProcessPoolExecutor(options.workers) as pool:
        outcomes = [o for found in pool.map(_outcomes, seeds, chunksize=4) for o in found]
    results = {
        "machine": machine,
        "first_seed": options.first_seed,
        "seconds": round(time.perf_counter() - start, 1),
        **summary(outcomes),
    }
    if options.all:
        results["outcomes"] = [asdict(outcome) for outcome in outcomes]
    report("sync_check", results, options.json)


if __name__ == "__main__":
    main()
