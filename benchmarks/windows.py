"""Windows per second of TPPWindows, against the bare decoder and against LeRobotDataset.

Real GelSight frames (the PhysiCLeAR clips), 8 tactile frames and 1 RGB frame of 224x224 a window,
with synthetic 90 Hz poses and 500 Hz widths, one process on one core, all in one run::

    python benchmarks/windows.py --real DATA --work FOLDER --json results/windows.json \
        [--lerobot VENV/bin/python]
"""

import argparse
import json
import os
import shutil
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, one_core, report, timed

PEER = Path(__file__).parent / "peers" / "lerobot_windows.py"


def build(real: Path, work: Path, *, gray: bool) -> Path:
    """Convert, prepare and combine the clips into a training set; made once."""
    import exumi_converters as converters
    import exumi_data
    from exumi_data.catalog import build_catalog, episode_path, write_catalog
    from exumi_data.dataset import create_dataset, open_dataset
    from exumi_data.model import Clock, EncodedImages, EpisodeMetadata, Frames
    from exumi_data.model.documents import dump

    target = work / ("windows-grey" if gray else "windows-rgb")
    if (target / "catalog.parquet").exists():
        return target
    native, colour = work / "native", work / "prepared-rgb"
    options = converters.ConvertOptions(labels=real / "labels.csv", keep_going=True)
    converters.convert(real / "videos", native, from_format="octopi", options=options)
    converters.prepare(native, colour)
    tactile = colour
    if gray:
        tactile = work / "prepared-grey"
        converters.prepare(native, tactile, gray=True)
    rgb_set, tactile_set = open_dataset(colour), open_dataset(tactile)
    by_parent = {episode.metadata.source.parent_id: episode for episode in rgb_set}
    create_dataset(target, tactile_set.metadata)
    rng = np.random.default_rng(0)
    for episode in tactile_set:
        stream = episode["tactile"]
        document = {**dump(episode.metadata), "streams": {}}
        metadata = EpisodeMetadata.model_validate_json(json.dumps(document))
        with exumi_data.EpisodeWriter(target / episode_path(episode.id), metadata) as writer:
            clock = Clock(source="none", stamp_point="nominal_rate")
            sources: list[tuple[str, Any, str]] = [
                ("tactile", stream, "tactile"),
                ("rgb", by_parent[episode.metadata.source.parent_id]["tactile"], "rgb"),
            ]
            for name, source, kind in sources:
                images = source.metadata.images
                out = writer.add_stream(
                    name,
                    kind=kind,
                    clock=clock,
                    images=EncodedImages(
                        encoding="encoded",
                        media_type="image/jpeg",
                        height=images.height,
                        width=images.width,
                        channels=images.channels,
                    ),
                )
                out.append(source.time, [source.encoded(i) for i in range(len(source))])
                if kind == "tactile":
                    out.set_reference(source.reference, method="selected")
            end = int(stream.time[-1])
            add_low_dimensional(writer, clock, Frames(parent="world", child="tcp"), end, rng)
            activity = np.asarray(stream.activity)
            writer.add_derived("tactile", "activity", activity, algorithm="exumi-activity/1")
    table, failed = build_catalog(target)
    if failed:
        raise SystemExit(f"episodes cannot be read: {failed}")
    write_catalog(target, table)
    return target


def add_low_dimensional(
    writer: Any, clock: Any, frames: Any, end: int, rng: np.random.Generator
) -> None:
    """Add synthetic poses at 90 Hz and widths at 500 Hz, so that their cost is not hidden."""
    from scipy.spatial.transform import Rotation

    time = np.arange(0, end + 11_111_111, 11_111_111)
    position = np.cumsum(rng.normal(0, 1e-3, (len(time), 3)), axis=0)
    turn = np.cumsum(rng.normal(0, 1e-2, (len(time), 3)), axis=0)
    poses = np.concatenate((position, Rotation.from_rotvec(turn).as_quat()), axis=1)
    writer.add_stream("pose", kind="pose", clock=clock, frames=frames).append(time, poses)
    time = np.arange(0, end + 2_000_000, 2_000_000)
    width = 0.05 + 0.03 * np.sin(time * 1e-9)
    writer.add_stream("width", kind="width", clock=clock).append(time, width)


def make_windows(dataset: Path) -> Any:
    """Open the training set as windows, with the history at fixed steps as LeRobot needs it."""
    from exumi_data.dataset import open_dataset
    from exumi_loaders import TPPWindows

    return TPPWindows(open_dataset(dataset), random_history=False, edges="drop", cache=False)


def run_ours(
    windows: Any, count: int, repeats: int, batch: int, transform: Any = None
) -> dict[str, Any]:
    """Measure TPPWindows through its loader, in this process."""
    from exumi_loaders import prefetch_to_device

    def once() -> int:
        done = 0
        loader = windows.loader(batch, shuffle=True)
        for item in prefetch_to_device(loader, "cpu", transform=transform):
            done += len(item["valid"])
            if done >= count:
                break
        return done

    once()
    return timed(once, repeats)


def run_decoding(windows: Any, count: int, repeats: int) -> dict[str, Any]:
    """Measure the bare limit: the same JPEGs, already in memory, decoded in a loop."""
    import cv2
    import simplejpeg

    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(windows))[:count]
    readers = windows._readers  # the same frames, read before the clock starts
    jobs = []
    for index in chosen:
        episode = int(windows._episode[index])
        anchor = int(windows._anchors[index])
        files = []
        for name, steps in (("tactile", (-12, -8, -4, 0, 4, 8, 12, 16)), ("rgb", (0,))):
            source = readers.get(episode, name)[0]._source
            ticks = np.clip(
                anchor + np.array(steps),
                windows.timeline.edges[episode],
                windows.timeline.edges[episode + 1] - 1,
            )
            frames = windows.timeline.frame[name][ticks]
            files += [(source.file(int(k)), name) for k in frames if k >= 0]
        jobs.append(files)
    channels = {name: windows.layout.shapes[name][2] for name in ("tactile", "rgb")}
    spaces = {name: "GRAY" if count == 1 else "RGB" for name, count in channels.items()}
    flags = {
        n: cv2.IMREAD_GRAYSCALE if c == 1 else cv2.IMREAD_COLOR_RGB for n, c in channels.items()
    }

    def with_simplejpeg() -> int:
        for files in jobs:
            for data, name in files:
                simplejpeg.decode_jpeg(data, spaces[name])
        return len(jobs)

    def with_opencv() -> int:
        for files in jobs:
            for data, name in files:
                cv2.imdecode(np.frombuffer(data, np.uint8), flags[name])
        return len(jobs)

    with_simplejpeg()
    size = [len(data) for files in jobs for data, name in files if name == "tactile"]
    return {
        "simplejpeg": timed(with_simplejpeg, repeats),
        "opencv": timed(with_opencv, repeats),
        "tactile_bytes_per_frame": round(float(np.mean(size))),
    }


def export_for_lerobot(dataset: Path, target: Path, count: int) -> None:
    """Write frames at ticks of 1/25 s and low-dimensional values as the peer script reads them.

    Of the first `count` episodes: writing LeRobot's AV1 takes seconds an episode, and its reading
    does not depend on how many there are.
    """
    from exumi_data.dataset import open_dataset
    from exumi_loaders import TPPWindows

    if (target / "meta.json").exists():
        return
    shutil.rmtree(target, ignore_errors=True)
    opened = open_dataset(dataset)[:count]
    timeline = TPPWindows(opened, cache=False, tick_s=Fraction(1, 25)).timeline
    episodes = []
    (target / "lowdim").mkdir(parents=True)
    for number, episode in enumerate(opened):
        first, end = int(timeline.edges[number]), int(timeline.edges[number + 1])
        if end - first < 32:
            continue
        for name in ("tactile", "rgb"):
            folder = target / "frames" / episode.id / name
            folder.mkdir(parents=True)
            for tick in range(first, end):
                data = episode[name].encoded(max(int(timeline.frame[name][tick]), 0))
                (folder / f"{tick - first:06d}.jpg").write_bytes(data)
        np.savez(
            target / "lowdim" / f"{episode.id}.npz",
            pose=timeline.low["pose"][first:end],
            width=timeline.low["width"][first:end],
        )
        episodes.append({"id": episode.id, "n": end - first})
    (target / "meta.json").write_text(json.dumps({"fps": 25, "episodes": episodes}))


def run_lerobot(
    python: str | None, dataset: Path, work: Path, arguments: argparse.Namespace, tactile: str
) -> dict[str, Any]:
    """Measure LeRobotDataset in its own environment, or say why not."""
    if not python:
        return {"skipped": "LeRobot is not installed: give --lerobot VENV/bin/python"}
    export_for_lerobot(dataset, work / f"lerobot-input-{tactile}", arguments.peer_episodes)
    result = work / f"lerobot-{tactile}.json"
    command = [python, str(PEER), "--input", str(work / f"lerobot-input-{tactile}")]
    command += ["--work", str(work / f"lerobot-{tactile}"), "--json", str(result)]
    command += ["--windows", str(arguments.peer_windows), "--repeats", str(arguments.repeats)]
    command += ["--tactile", tactile]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"skipped": f"the peer failed: {done.stderr[-400:]}"}
    outcome: dict[str, Any] = json.loads(result.read_text())
    return outcome


def peer_ratios(ours: dict[str, Any], peer: dict[str, Any]) -> dict[str, float] | None:
    """Compare with LeRobot as it is, and with a C library told to keep freed memory.

    The second is a setting that its users do not have, but twice as fast: see peers/README.md.
    """
    if "by_allocator" not in peer:
        return None
    ratios = {}
    for name, measured in peer["by_allocator"].items():
        ratios[name] = round(ours["median"] / measured["windows_per_s"], 1)
        by_processor = float(np.median(measured["windows_per_cpu_s_all"]))
        ratios[f"{name}_per_cpu_s"] = round(ours["per_cpu_s"] / by_processor, 1)
    return ratios


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--real", type=Path, required=True, help="folder like data/, with physiclear/"
    )
    parser.add_argument("--work", type=Path, required=True, help="where to keep what is built")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--windows", type=int, default=4000)
    parser.add_argument("--peer-windows", type=int, default=300)
    parser.add_argument("--peer-episodes", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--lerobot", help="python of the environment that LeRobot is installed in")
    arguments = parser.parse_args()
    results: dict[str, Any] = {}
    sets = {
        tactile: build(arguments.real / "physiclear", arguments.work, gray=tactile == "grey")
        for tactile in ("grey", "rgb")
    }
    machine = describe_machine(("exumi-data", "numpy", "simplejpeg", "torch"))
    cores = one_core()
    import torch

    from exumi_loaders import ToFloat

    torch.set_num_threads(1)
    for tactile, dataset in sets.items():
        windows = make_windows(dataset)
        ours = run_ours(windows, arguments.windows, arguments.repeats, arguments.batch)
        floats = run_ours(
            windows,
            arguments.windows,
            arguments.repeats,
            arguments.batch,
            ToFloat(memory="contiguous"),
        )
        limit = run_decoding(windows, min(arguments.windows, 2000), arguments.repeats)
        os.sched_setaffinity(0, cores)  # the peer builds on all cores, and measures on one
        peer = run_lerobot(arguments.lerobot, dataset, arguments.work, arguments, tactile)
        one_core()
        bare = max((limit["simplejpeg"], limit["opencv"]), key=lambda measured: measured["median"])
        results[tactile] = {
            "windows": len(windows),
            "exumi_windows_per_s": ours,
            "exumi_float32_chw_windows_per_s": floats,
            "decoding_only_windows_per_s": limit,
            "lerobot": peer,
            "ratio_to_decoding": round(ours["median"] / bare["median"], 3),
            "ratio_to_decoding_per_cpu_s": round(ours["per_cpu_s"] / bare["per_cpu_s"], 3),
            "ratio_to_lerobot": peer_ratios(ours, peer),
            "ratio_to_lerobot_float32_chw": peer_ratios(floats, peer),
        }
    report("windows", {"machine": machine, **results}, arguments.json)


if __name__ == "__main__":
    main()
