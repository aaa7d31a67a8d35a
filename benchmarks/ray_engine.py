"""What a Ray cluster on this machine costs, against as many processes without it.

The same clips are converted, and the result validated, by two processes, by a cluster of one node
with two processors, and by one of two nodes with one each. Every run has a cluster and workers of
its own; starting and ending the cluster is timed apart. A run goes through the clips several times,
into a new dataset each time: nobody joins a cluster for a job of ten seconds, of which the start of
the workers is a large part. The first pass, which has that part, is given apart.

::

    python benchmarks/ray_engine.py --real DATA --work FOLDER --json results/ray_engine.json
"""

import argparse
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from measuring import describe_machine, report

from exumi_data.engine.outcome import Engine

WORKERS = 2
STORE_BYTES = 80 << 20


@contextmanager
def one_node() -> Iterator[Engine]:
    """Start what ``--engine ray`` starts where there is no cluster."""
    from exumi_data.engine.ray_engine import ray_engine

    with ray_engine("local", workers=WORKERS) as engine:
        yield engine


@contextmanager
def two_nodes() -> Iterator[Engine]:
    """Start two nodes of one processor each, and join them."""
    from ray.cluster_utils import Cluster

    from exumi_data.engine.ray_engine import ray_engine

    cluster: Any = Cluster(shutdown_at_exit=False)
    try:
        for _ in range(WORKERS):
            cluster.add_node(num_cpus=1, object_store_memory=STORE_BYTES, include_dashboard=False)
        with ray_engine(cluster.address) as engine:
            yield engine
    finally:
        cluster.shutdown()


@contextmanager
def no_cluster() -> Iterator[None]:
    """Leave the work to processes of this machine."""
    yield


def clips_in(source: Path, work: Path, most: int) -> Path:
    """Copy some of the clips, evenly spread over all."""
    folder = work / "bench-ray-clips"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    videos = sorted((source / "videos").glob("*.mov"))
    for video in videos[:: max(1, len(videos) // most)][:most]:
        shutil.copy(video, folder)
    return folder


def run_once(
    start: Callable[[], Any], clips: Path, labels: Path, target: Path, passes: int
) -> tuple[dict[str, float], int]:
    """Convert and validate a few times; return seconds of each part, and the number of episodes."""
    import exumi_converters as converters
    from exumi_validators import validate

    seconds = dict.fromkeys(("start", "convert", "validate", "stop", "first_pass"), 0.0)
    episodes = 0
    clock = time.perf_counter

    def lap(name: str, since: float) -> float:
        seconds[name] += clock() - since
        return clock()

    at = clock()
    with start() as engine:
        at = lap("start", at)
        for number in range(passes):
            shutil.rmtree(target, ignore_errors=True)
            at = clock()
            options = converters.ConvertOptions(labels=labels, workers=WORKERS, keep_going=True)
            done: Any = converters.convert(
                clips, target, from_format="octopi", options=options, engine=engine
            )
            at = lap("convert", at)
            checked = validate(target, workers=WORKERS, engine=engine)
            at = lap("validate", at)
            if number == 0:
                seconds["first_pass"] = seconds["convert"] + seconds["validate"]
            if not checked.valid or done.failed:
                raise SystemExit("the conversion went wrong")
            episodes += done.converted
    lap("stop", at)
    return seconds, episodes


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", type=Path, required=True, help="folder with physiclear/")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--clips", type=int, default=264)
    parser.add_argument("--passes", type=int, default=4, help="through the clips, in a run")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "ray", "numpy", "av"))
    source = arguments.real / "physiclear"
    clips = clips_in(source, arguments.work, arguments.clips)
    ways = {"local": no_cluster, "ray_one_node": one_node, "ray_two_nodes": two_nodes}
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in ways}
    episodes = 0
    with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp") as folder:
        # Nobody else's cluster is met, or told of these.
        os.environ |= {"RAY_TMPDIR": folder, "RAY_USAGE_STATS_ENABLED": "0"}
        # One after the other and again: what else the machine does meets all of them.
        for _ in range(arguments.repeats):
            for name, start in ways.items():
                target = arguments.work / f"bench-ray-{name}"
                seconds, episodes = run_once(
                    start, clips, source / "labels.csv", target, arguments.passes
                )
                runs[name].append(seconds)
    results: dict[str, Any] = {
        "machine": machine,
        "workers": WORKERS,
        "passes": arguments.passes,
        "episodes": episodes,
    }
    results["seconds"] = {
        name: {part: round(statistics.median(run[part] for run in own), 2) for part in own[0]}
        for name, own in runs.items()
    }
    results["all"] = [
        {name: {part: round(value, 2) for part, value in run.items()} for name, run in turn}
        for turn in (
            list(zip(runs, each, strict=True)) for each in zip(*runs.values(), strict=True)
        )
    ]
    results["overhead"] = {
        name: overhead(runs["local"], runs[name]) for name in runs if name != "local"
    }
    report("ray_engine", results, arguments.json)


def overhead(local: list[dict[str, float]], ray: list[dict[str, float]]) -> dict[str, float]:
    """Return how much longer it takes, as medians of the ratios of neighbouring runs less one.

    And the ratio of the fastest runs: on a machine that does other things, the least disturbed.
    """
    found: dict[str, float] = {}
    for name, parts, more in (
        ("convert", ("convert",), ()),
        ("validate", ("validate",), ()),
        ("both", ("convert", "validate"), ()),
        ("first_pass", ("first_pass",), ()),
        ("both_with_start_and_stop", ("convert", "validate"), ("start", "stop")),
    ):
        ratios = [
            sum(there[part] for part in (*parts, *more)) / sum(here[part] for part in parts) - 1
            for here, there in zip(local, ray, strict=True)
        ]
        found[name] = round(statistics.median(ratios), 3)
    fastest = [min(run["convert"] + run["validate"] for run in runs) for runs in (local, ray)]
    found["both_of_the_fastest_runs"] = round(fastest[1] / fastest[0] - 1, 3)
    return found


if __name__ == "__main__":
    main()
