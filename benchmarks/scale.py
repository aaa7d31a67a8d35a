"""Large sets: opening a hundred thousand episodes, and the first active batch of 480,000 frames.

The catalog of the first is synthetic, its episodes are empty folders: opening reads none. The
frames of the second are small, in episodes of a minute and of five seconds. Each figure is of a new
process::

    python benchmarks/scale.py --work FOLDER --json results/scale.json
"""

import argparse
import json
import shutil
import subprocess
import sys
import uuid
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

SIDE = 64
RATE = 25
OPEN = """
import json, resource, sys, time
start = time.perf_counter()
import exumi_data
dataset = exumi_data.open(sys.argv[1])
count = len(dataset)
took = time.perf_counter() - start
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"episodes": count, "open_s": round(took, 3), "peak_mib": round(peak)}))
"""
FIRST = """
import json, resource, sys, time
start = time.perf_counter()
import exumi_data
from exumi_loaders import ActiveWindowSampler, TPPWindows
windows = TPPWindows(exumi_data.open(sys.argv[1]), cache=sys.argv[2])
sampler = ActiveWindowSampler(windows)
batch = next(iter(windows.loader(64, sampler=sampler)))
took = time.perf_counter() - start
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
assert len(batch["valid"]) == 64
print(json.dumps({"windows": len(windows), "seconds": round(took, 3), "peak_mib": round(peak)}))
"""


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--episodes", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=480_000)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    results: dict[str, Any] = {
        "machine": describe_machine(("exumi-data", "numpy", "pyarrow", "torch"))
    }
    catalog = _catalog(arguments.work / f"catalog-{arguments.episodes}", arguments.episodes)
    results["open"] = [_run(OPEN, catalog) for _ in range(arguments.repeats)]
    for seconds in (60, 5):
        name = f"frames-{arguments.frames}-{seconds}s"
        dataset = _frames(arguments.work / name, arguments.frames, seconds * RATE)
        cache = arguments.work / "scale-cache"
        rows = []
        for _ in range(arguments.repeats):
            shutil.rmtree(cache, ignore_errors=True)
            rows.append(
                {"cold": _run(FIRST, dataset, cache), "cached": _run(FIRST, dataset, cache)}
            )
        results[f"first_active_batch_{seconds}_s_episodes"] = rows
    report("scale", results, arguments.json)


def _run(script: str, *arguments: Path) -> dict[str, Any]:
    command = [sys.executable, "-c", script, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _catalog(target: Path, count: int) -> Path:
    """Write a dataset whose catalog has many rows: one real row, with ids and paths of its own."""
    import pyarrow as pa

    from exumi_data.catalog import episode_path, write_catalog
    from exumi_data.dataset import create_dataset, open_dataset

    if (target / "catalog.parquet").exists():
        return target
    shutil.rmtree(target, ignore_errors=True)
    small = _frames(target.with_name("one-episode"), 50, 50)
    opened = open_dataset(small)
    create_dataset(target, opened.metadata)
    rows = opened.catalog.take(pa.array(np.zeros(count, dtype=np.int64)))
    ids = sorted(
        str(uuid.UUID(bytes=np.random.default_rng(k).bytes(16), version=5)) for k in range(count)
    )
    for name, values in (("id", ids), ("path", [episode_path(each) for each in ids])):
        column = rows.schema.get_field_index(name)
        field = rows.schema.field(name)
        rows = rows.set_column(column, field, pa.array(values, type=field.type))
    for each in ids:  # opening lists them, and looks into none
        (target / episode_path(each)).mkdir(parents=True)
    write_catalog(target, rows)
    return target


def _frames(target: Path, frames: int, length: int) -> Path:
    """Write a dataset of small grey JPEGs, one tactile stream and a pose, a tenth of it active."""
    from exumi_data.catalog import build_catalog, episode_path, write_catalog
    from exumi_data.dataset import create_dataset
    from exumi_data.model import (
        Clock,
        DatasetMetadata,
        EncodedImages,
        EpisodeMetadata,
        Source,
        Task,
    )
    from exumi_data.model import Frames as PoseFrames
    from exumi_data.store import jpeg
    from exumi_data.store.episode_writer import EpisodeWriter

    if (target / "catalog.parquet").exists():
        return target
    shutil.rmtree(target, ignore_errors=True)
    create_dataset(target, DatasetMetadata(name=target.name, licence="CC0-1.0"))
    rng = np.random.default_rng(0)
    files = [jpeg.encode(rng.integers(90, 110, (SIDE, SIDE, 1), np.uint8), 95) for _ in range(64)]
    images = EncodedImages(
        encoding="encoded", media_type="image/jpeg", height=SIDE, width=SIDE, channels=1
    )
    clock = Clock(source="none", stamp_point="nominal_rate")
    time = np.arange(length) * (1_000_000_000 // RATE)
    at = np.arange(0, time[-1] + 11_111_111, 11_111_111)
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (len(at), 1))
    for number in range(-(-frames // length)):
        known = uuid.uuid5(uuid.NAMESPACE_URL, f"{target.name}/{number}")
        metadata = EpisodeMetadata(
            id=str(known),
            licence="CC0-1.0",
            task=Task(name="play"),
            regime="play",
            source=Source(type="simulated", tool="benchmarks/scale.py", tool_version="1"),
        )
        path = target / episode_path(metadata.id)
        with EpisodeWriter(path, metadata, durable=False) as writer:
            out = writer.add_stream("tactile", kind="tactile", clock=clock, images=images)
            out.append(time, [files[k] for k in rng.integers(len(files), size=length)])
            frames_of = PoseFrames(parent="world", child="tcp")
            writer.add_stream("pose", kind="pose", clock=clock, frames=frames_of).append(at, poses)
            activity = np.where(np.arange(length) < length // 10, 0.1, 0).astype(np.float32)
            writer.add_derived("tactile", "activity", activity, algorithm="exumi-activity/1")
    table, failed = build_catalog(target)
    if failed:
        raise SystemExit(f"episodes cannot be read: {failed}")
    write_catalog(target, table)
    return target


if __name__ == "__main__":
    main()
