"""Shared by the benchmarks: machine, versions, medians, and JSON results."""

import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

__all__ = ["Timing", "describe_machine", "one_core", "report", "timed"]

Timing = dict[str, Any]


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def describe_machine(packages: tuple[str, ...]) -> dict[str, Any]:
    """Return processor, cores, load and the versions of some packages."""
    versions = {"python": platform.python_version()}
    for name in packages:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 2),
        "system": platform.platform(terse=True),
        "versions": versions,
    }


def one_core() -> set[int]:
    """Keep this process on one core; return the cores that it had."""
    had = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(had)})
    return had


def timed(function: Callable[[], int], repeats: int) -> Timing:
    """Run a function that returns how much it did; report amounts per second.

    By the clock, and by the processor time of this process: look at that when other jobs run on
    the machine, and the function starts no process of its own.

    Parameters
    ----------
    function : callable
        Does the work, returns the amount (windows, frames ...).
    repeats : int
    """
    rates, by_processor = [], []
    for _ in range(repeats):
        start, used = time.perf_counter(), time.process_time()
        amount = function()
        rates.append(amount / (time.perf_counter() - start))
        by_processor.append(amount / (time.process_time() - used))
    return {
        "median": statistics.median(rates),
        "all": [round(rate, 1) for rate in rates],
        "per_cpu_s": round(statistics.median(by_processor), 1),
        "per_cpu_s_all": [round(rate, 1) for rate in by_processor],
    }


def report(name: str, results: dict[str, Any], output: Path | None) -> None:
    """Print results, and write them as JSON."""
    text = json.dumps({"benchmark": name, **results}, indent=1)
    print(text)
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text + "\n", encoding="utf-8")
