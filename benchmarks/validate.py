"""Episodes per second of validating at each level, and level ``data`` against bare decoding.

The bare loop reads the frames of each episode and decodes every one of them, in as many processes,
started in the same way, in the same run::

    python benchmarks/validate.py --dataset WORK/bench-native --json results/validate.json
"""

import argparse
import itertools
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report, timed

from exumi_data.catalog import list_episodes
from exumi_data.engine import map_items
from exumi_data.standard import LEVELS
from exumi_data.store import jpeg
from exumi_data.store.access import FolderStore
from exumi_data.store.shards import ArrayReader, open_array
from exumi_data.store.video import VideoDecoder


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, action="append", required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    packages = ("exumi-data", "av", "simplejpeg", "numpy", "opencv-contrib-python-headless")
    results: dict[str, Any] = {"machine": describe_machine(packages), "workers": arguments.workers}
    for dataset in arguments.dataset:
        results[dataset.name] = _measure(dataset, arguments.workers, arguments.repeats)
    report("validate", results, arguments.json)


def _measure(dataset: Path, workers: int, repeats: int) -> dict[str, Any]:
    paths = list_episodes(dataset)
    if any(path.endswith(".zip") for path in paths):
        raise SystemExit(f"{dataset}: the bare loop reads folders, not packed episodes")
    validate, bare = partial(_validate, dataset, workers), partial(_bare, dataset, paths, workers)
    if (seen := validate("data")[1]) != (known := bare()):
        raise SystemExit(f"{dataset}: {seen} frames were validated, {known} decoded")
    found: dict[str, Any] = {"episodes": len(paths), "frames": known}
    for level in LEVELS:
        found[f"{level}_episodes_per_s"] = timed(partial(_episodes_at, validate, level), repeats)
    # One after the other, so that both see the same neighbours on the machine.
    rates: dict[str, list[float]] = {"data": [], "bare": []}
    runs: dict[str, Callable[[], int]] = {"data": lambda: validate("data")[1], "bare": bare}
    for _ in range(repeats):
        for name, run in runs.items():
            rates[name].append(timed(run, 1)["median"])
    for name, values in rates.items():
        median, shown = float(np.median(values)), [round(value) for value in values]
        found[f"{name}_frames_per_s"] = {"median": round(median), "all": shown}
    ratios = [a / b for a, b in zip(rates["data"], rates["bare"], strict=True)]
    found["data_to_bare"] = round(float(np.median(ratios)), 3)
    return found


def _validate(dataset: Path, workers: int, level: Any) -> tuple[int, int]:
    from exumi_validators import validate

    levels = LEVELS[: LEVELS.index(level) + 1]  # as --level has it
    coverage = validate(dataset, levels=levels, workers=workers).coverage
    return coverage.episodes, coverage.frames


def _episodes_at(validate: Callable[[Any], tuple[int, int]], level: str) -> int:
    return validate(level)[0]


def _bare(dataset: Path, paths: list[str], workers: int) -> int:
    decode = partial(_decode_episode, dataset=str(dataset))
    return sum(outcome.value or 0 for outcome in map_items(decode, paths, workers=workers))


def _decode_episode(path: str, *, dataset: str) -> int:
    """Decode every frame of an episode, and do nothing with it."""
    store = FolderStore(f"{dataset}/{path}")
    try:
        streams = json.loads(store.read("zarr.json"))["attributes"]["exumi"]["streams"]
        return sum(
            _decode_stream(store, f"streams/{name}", stream["images"])
            for name, stream in streams.items()
            if "images" in stream
        )
    finally:
        store.close()


def _decode_stream(store: FolderStore, base: str, images: dict[str, Any]) -> int:
    data, offset = open_array(store, f"{base}/data"), open_array(store, f"{base}/offset").read()
    if not isinstance(data, ArrayReader):
        raise SystemExit(f"{base}: not in the standard layout")
    edges = offset.tolist()
    files = (data.bytes_at(a, b - a) for a, b in itertools.pairwise(edges))
    if images["encoding"] == "video":
        return sum(_decode_video(file) for file in files)
    out = np.empty((images["height"], images["width"], images["channels"]), np.uint8)
    count = 0
    for file in files:
        jpeg.decode_into(file, out)
        count += 1
    return count


def _decode_video(file: bytes) -> int:
    with VideoDecoder(file, "the video") as decoder:
        return sum(1 for _ in decoder.frames())


if __name__ == "__main__":
    main()
