"""How old a pose is when the recorder has it: from the kernel's stamp to what `read` returns.

A simulated headset of another process sends at 90 Hz; each pose must arrive.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from measuring import describe_machine, report

from exumi_recorders.contract import Sample
from exumi_recorders.drivers.quest import Quest
from exumi_recorders.drivers.quest_options import QuestOptions
from exumi_recorders.simulated.headset_options import HeadsetOptions

__all__ = ["main", "measure"]


def measure(duration_s: float, dialect: str, rate_hz: int) -> dict[str, object]:
    """Record poses for some time; return their ages and how many are missing.

    Parameters
    ----------
    duration_s : float
    dialect : str
    rate_hz : int
    """
    driver = Quest(QuestOptions(host="127.0.0.1", port=0, headset=False))
    driver.open()
    options = HeadsetOptions.model_validate(
        {
            "port": driver.address[1],
            "dialect": dialect,
            "rate_hz": rate_hz,
            "duration_s": duration_s,
        }
    )
    command = [sys.executable, "-m", "exumi_recorders.simulated.headset", options.model_dump_json()]
    ages_ns: list[int] = []
    before_s = time.process_time()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as headset:
        ended = False
        while not ended:
            ended = headset.poll() is not None  # and then once more, for the last
            found = driver.read(0.1)
            now_ns = time.monotonic_ns()
            ages_ns += [now_ns - each.time_host_ns for each in found if isinstance(each, Sample)]
    used_s = time.process_time() - before_s
    health = driver.health()
    driver.close()
    ages_ms = np.array(ages_ns) * 1e-6
    expected = int(duration_s * rate_hz)
    return {
        "dialect": dialect,
        "rate_hz": rate_hz,
        "duration_s": duration_s,
        "poses": len(ages_ms),
        "missing": expected - len(ages_ms),
        "lost_by_cause": dict(health.lost),
        "age_ms": {
            "median": round(float(np.median(ages_ms)), 3),
            "p99": round(float(np.percentile(ages_ms, 99)), 3),
            "largest": round(float(ages_ms.max()), 3),
        },
        "stamp_sigma_ns": health.stamp_sigma_ns,
        "share_of_a_core": round(used_s / duration_s, 4),
    }


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--duration", type=float, default=60.0, help="seconds")
    parser.add_argument("--dialect", choices=("a", "b", "c", "d"), default="b")
    parser.add_argument("--rate", type=int, choices=(60, 72, 90), default=90)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    machine = describe_machine(("numpy", "pydantic"))
    results = measure(options.duration, options.dialect, options.rate)
    report("pose_age", {"machine": machine, **results}, options.json)


if __name__ == "__main__":
    main()
