"""Episodes per second of validating at each level, and level ``data`` against bare decoding.

The bare loop reads the frames of each episode and decodes every one of them to the pixels that the
stream declares, (H, W, C) uint8, in as many processes, started in the same way, in the same run. Of
video there is a second one, ``codec``: it runs FFmpeg's decoder and takes no pixels out of it::

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
from exumi_data.store.video import FramePixels, VideoDecoder


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
    runs: dict[str, Callable[[], int]] = {"data": lambda: validate("data")[1], "bare": bare}
    if any("video" in encodings for encodings in map(partial(_encodings, dataset), paths)):
        runs["codec"] = partial(_bare, dataset, paths, workers, pixels=False)
    rates: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            rates[name].append(timed(run, 1)["median"])
    for name, values in rates.items():
        median, shown = float(np.median(values)), [round(value) for value in values]
        found[f"{name}_frames_per_s"] = {"median": round(median), "all": shown}
    for name in runs.keys() - {"data"}:
        ratios = [a / b for a, b in zip(rates["data"], rates[name], strict=True)]
        found[f"data_to_{name}"] = round(float(np.median(ratios)), 3)
    return found


def _validate(dataset: Path, workers: int, level: Any) -> tuple[int, int]:
    from exumi_validators import validate

    levels = LEVELS[: LEVELS.index(level) + 1]  # as --level has it
    coverage = validate(dataset, levels=levels, workers=workers).coverage
    return coverage.episodes, coverage.frames


def _episodes_at(validate: Callable[[Any], tuple[int, int]], level: str) -> int:
    return validate(level)[0]


def _bare(dataset: Path, paths: list[str], workers: int, *, pixels: bool = True) -> int:
    decode = partial(_decode_episode, dataset=str(dataset), pixels=pixels)
    return sum(outcome.value or 0 for outcome in map_items(decode, paths, workers=workers))


def _streams(store: FolderStore) -> dict[str, Any]:
    streams: dict[str, Any] = json.loads(store.read("zarr.json"))["attributes"]["exumi"]["streams"]
    return streams


def _encodings(dataset: Path, path: str) -> set[str]:
    streams = _streams(FolderStore(dataset / path)).values()
    return {stream["images"]["encoding"] for stream in streams if "images" in stream}


def _decode_episode(path: str, *, dataset: str, pixels: bool = True) -> int:
    """Decode every frame of an episode, and do nothing with it."""
    store = FolderStore(f"{dataset}/{path}")
    try:
        return sum(
            _decode_stream(store, f"streams/{name}", stream["images"], pixels=pixels)
            for name, stream in _streams(store).items()
            if "images" in stream
        )
    finally:
        store.close()


def _decode_stream(store: FolderStore, base: str, images: dict[str, Any], *, pixels: bool) -> int:
    data, offset = open_array(store, f"{base}/data"), open_array(store, f"{base}/offset").read()
    if not isinstance(data, ArrayReader):
        raise SystemExit(f"{base}: not in the standard layout")
    edges = offset.tolist()
    files = (data.bytes_at(a, b - a) for a, b in itertools.pairwise(edges))
    out = np.empty((images["height"], images["width"], images["channels"]), np.uint8)
    if images["encoding"] == "video":
        return sum(_decode_video(file, out if pixels else None) for file in files)
    count = 0
    for file in files:
        jpeg.decode_into(file, out)
        count += 1
    return count


def _decode_video(file: bytes, out: np.ndarray | None) -> int:
    count, pixels = 0, FramePixels()
    with VideoDecoder(file, "the video") as decoder:
        for frame in decoder.frames():
            count += 1
            if out is not None:
                pixels.into(frame, out)
    return count


if __name__ == "__main__":
    main()
