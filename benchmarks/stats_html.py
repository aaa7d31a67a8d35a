"""Seconds and bytes of the page of ``exumi stats --html``, and the memory that it takes.

What a page takes beyond what has to be read anyway: `validate` and `measure` read the data first,
then the page looks at some frames, draws and is written. Its seconds include its own decoding. Its
processor time, with one process, is the figure to look at where other jobs run on the machine::

    python benchmarks/stats_html.py --dataset DATASET --work WORK --json results/stats_html.json
"""

import argparse
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from measuring import describe_machine, report

import exumi_data
from exumi_data.cli.stats_html import judgement_of
from exumi_data.stats import measure
from exumi_data.stats.html import page_of, write_page
from exumi_validators import validate

Value = TypeVar("Value")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, action="append", required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    packages = ("exumi-data", "av", "simplejpeg", "numpy", "opencv-contrib-python-headless")
    results: dict[str, Any] = {"machine": describe_machine(packages), "workers": arguments.workers}
    for dataset in arguments.dataset:
        results[dataset.name] = page(dataset, arguments.work, arguments.workers)
    report("stats_html", results, arguments.json)


def page(path: Path, work: Path, workers: int) -> dict[str, Any]:
    """Make the page of one dataset, twice; the second is to be the same to the byte."""
    source = exumi_data.open(path)
    found, validating_s = timed(lambda: validate(path, workers=workers))
    statistics, measuring_s = timed(lambda: measure(source, workers=workers))
    judgement = judgement_of(found)
    before = peak_mib()
    html, page_s = timed(lambda: page_of(source, statistics, judgement=judgement, workers=workers))
    size, writing_s = timed(lambda: write_page(work / f"{path.name}.html", html))
    used = time.process_time()
    again = page_of(source, statistics, judgement=judgement, workers=1)
    cpu_s = time.process_time() - used
    return {
        "episodes": statistics.episodes,
        "frames": sum(s.n for s in statistics.streams if s.kind in ("tactile", "rgb")),
        "validating_s": round(validating_s, 2),
        "measuring_s": round(measuring_s, 2),
        "beyond_reading_s": round(page_s + writing_s, 2),
        "cpu_s_with_one_worker": round(cpu_s, 2),
        "bytes": size,
        "same_bytes_again": again == html,
        "peak_mib_before": before,
        "peak_mib": peak_mib(),
    }


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """Call a function; return its value and how long it took, seconds."""
    start = time.perf_counter()
    value = work()
    return value, time.perf_counter() - start


def peak_mib() -> int:
    """Return the most memory that this process, or any of its workers, ever had, MiB."""
    each = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return round(max(resource.getrusage(who).ru_maxrss for who in each) / 1024)


if __name__ == "__main__":
    main()
