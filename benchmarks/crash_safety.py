"""What a kill and a power loss cost: a recording program is killed at random moments, many times.

Each time the journal is recovered and the episode validated. A power loss is played by cutting each
log to the length that it had when it was last flushed before that moment. Told are how old the last
sample of each stream was, beyond the time to the next one, and whatever went wrong::

    python benchmarks/crash_safety.py --work FOLDER --times 200 --json results/crash_safety.json
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

from exumi_data.catalog import episode_path
from exumi_data.dataset import create_dataset
from exumi_data.episode import open_episode
from exumi_data.model import DatasetMetadata
from exumi_recorders.finalise.recover import recover
from exumi_recorders.journal.states import journal_folder
from exumi_validators import validate
from tests.exumi_recorders.numbered import PAYLOADS, episode, number_of
from tests.exumi_recorders.recording_process import RATES


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--most-seconds", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "numpy"))
    rng = np.random.default_rng(arguments.seed)
    results: dict[str, Any] = {"machine": machine}
    for name, promised_ms in (("kill", 50), ("power_loss", 600)):
        runs = []
        for number in range(arguments.times):
            seconds = float(rng.uniform(0, arguments.most_seconds))
            runs.append(one(arguments.work / "crash", seconds, power=name == "power_loss"))
            if number % 20 == 19:
                print(f"{name}: {number + 1} of {arguments.times}", file=sys.stderr)
        results[name] = summary(runs, promised_ms)
    table(results)
    report("crash_safety", results, arguments.json)


def one(root: Path, seconds: float, *, power: bool) -> dict[str, Any]:
    """Record for some time, end it, recover; return ages of the last samples, ms, and mistakes."""
    shutil.rmtree(root, ignore_errors=True)
    dataset, trace = root / "set", root / "trace"
    create_dataset(dataset, DatasetMetadata(name="crash", licence="CC0-1.0"))
    command = [sys.executable, "-m", "tests.exumi_recorders.recording_process", str(dataset)]
    program = subprocess.Popen([*command, str(trace)], stdout=subprocess.PIPE, text=True)
    if program.stdout is None or program.stdout.readline() != "recording\n":
        raise SystemExit("the program did not record")
    began_ns = time.monotonic_ns()
    time.sleep(seconds)
    ended_ns = time.monotonic_ns()
    program.send_signal(signal.SIGKILL)
    program.wait()
    program.stdout.close()
    if power:
        cut(journal_folder(dataset, episode().id), trace, ended_ns)
    first = recover([dataset])
    before = state_of(dataset)
    again = recover([dataset])
    mistakes = [reason for _, reason in first.failed]
    if again.done or again.failed or state_of(dataset) != before:
        mistakes.append("the second run changed something")
    if not mistakes:
        return judge(dataset, began_ns, ended_ns)
    return {"mistakes": mistakes, "ages": {}}


def cut(journal: Path, trace: Path, ended_ns: int) -> None:
    """Take from all logs what was not flushed."""
    safe: dict[str, int] = {}
    lines = trace.read_text(encoding="utf-8").splitlines() if trace.exists() else []
    for line in lines:
        at, length, path = line.split(" ", 2)
        if int(at) <= ended_ns:
            safe[path] = int(length)
    for log in journal.rglob("*.log"):
        os.truncate(log, safe.get(str(log), 0))


def state_of(dataset: Path) -> dict[str, tuple[int, int]]:
    """Return size and time of every file."""
    found = ((str(path), path.stat()) for path in dataset.rglob("*") if path.is_file())
    return {path: (info.st_size, info.st_mtime_ns) for path, info in found}


def judge(dataset: Path, began_ns: int, ended_ns: int) -> dict[str, Any]:
    """Compare what is in the episode with what was sent."""
    path = dataset / episode_path(episode().id)
    mistakes = [one.message for one in validate(path).problems if one.severity == "error"]
    ages = {}
    with open_episode(path) as found:
        for name, rate in RATES.items():
            period_ms = 1e3 / rate
            if name not in found:
                ages[name] = (ended_ns - began_ns) / 1e6
                continue
            stream = found[name]
            host, numbers = stream.time_host, stream.sequence
            if host is None or numbers is None:
                mistakes.append(f"{name} has no times or numbers")
                continue
            if (np.diff(numbers.astype(np.int64)) != 1).any():
                mistakes.append(f"{name} has holes")
            for index, number in enumerate(numbers.tolist()):
                if stream.is_image:
                    right = number_of(stream.encoded(index)) == number
                else:
                    right = stream.data[index].tobytes() == PAYLOADS[name](number)
                if not right:
                    mistakes.append(f"{name}: sample {index} is not what was sent")
                    break
            # Up to one period is what any recording lacks: the next sample was still to come.
            ages[name] = max(0.0, (ended_ns - int(host[-1])) / 1e6 - period_ms)
    return {"mistakes": mistakes, "ages": ages}


def summary(runs: list[dict[str, Any]], promised_ms: float) -> dict[str, Any]:
    """Return how much was lost, over all runs."""
    lost = {}
    for name in RATES:
        ages = [run["ages"][name] for run in runs if name in run["ages"]]
        marks = np.percentile(ages, [50, 99, 100]) if ages else [float("nan")] * 3
        keys = ("median_ms", "p99_ms", "most_ms")
        lost[name] = {key: round(float(mark), 2) for key, mark in zip(keys, marks, strict=True)}
        lost[name]["above_promise"] = sum(age > promised_ms for age in ages)
    mistakes = [mistake for run in runs for mistake in run["mistakes"]]
    return {
        "times": len(runs),
        "valid": sum(not run["mistakes"] for run in runs),
        "promised_ms": promised_ms,
        "lost": lost,
        "mistakes": mistakes[:10],
    }


def table(results: dict[str, Any]) -> None:
    """Print the figures for people."""
    for name in ("kill", "power_loss"):
        found = results[name]
        print(f"{name}: {found['valid']} of {found['times']} recovered to a valid episode")
        for stream, lost in found["lost"].items():
            print(
                f"  {stream:8} median {lost['median_ms']:7.2f} ms, 99 % {lost['p99_ms']:7.2f} ms, "
                f"most {lost['most_ms']:7.2f} ms; {lost['above_promise']} above "
                f"{found['promised_ms']} ms"
            )


if __name__ == "__main__":
    main()
