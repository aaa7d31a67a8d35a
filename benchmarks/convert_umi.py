"""Replay buffers to episodes: speed against a loop that only codes, and memory over two sizes.

Two buffers are made of moving pictures and a pressed gel, as exUMI makes them: 224x224, a camera in
JPEG XL, `tactile_combined` in three chunks a row. The loop does what a conversion cannot do
without: decode every chunk and code it as it is stored (camera JPEG, tactile zstd), in one process,
and nothing else. The conversion runs in one process, too; its time includes the episode's digest,
reference, activity and the catalog. Both are timed by the clock and by the processor time of their
process: look at that when other jobs run on the machine. Memory is the peak of the whole process,
which starts anew for each size.

::

    python benchmarks/convert_umi.py --work FOLDER --json results/convert_umi.json
"""

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

SIZE = 224
_DISTINCT = 60
_JPEGXL: dict[str, Any] = {"level": 99, "lossless": False, "numthreads": 1}


def _pictures() -> tuple[list[bytes], list[list[bytes]]]:
    """Return coded camera frames and tactile channels, some that repeat."""
    import cv2
    import imagecodecs

    rng = np.random.default_rng(0)
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    scene = cv2.resize(
        rng.integers(20, 235, (40, 40, 3)).astype(np.uint8),
        (320, 320),
        interpolation=cv2.INTER_CUBIC,
    )
    cameras, fingers = [], []
    base = 120 + 20 * x / SIZE
    for number in range(_DISTINCT):
        view = scene[number : number + SIZE, number // 2 : number // 2 + SIZE].astype(np.float32)
        view = (view + rng.normal(0, 2, view.shape)).clip(0, 255).astype(np.uint8)
        cameras.append(bytes(imagecodecs.jpegxl_encode(view, **_JPEGXL)))
        depth = 50 * max(0.0, np.sin(number / _DISTINCT * np.pi * 2))
        blob = np.exp(-((x - 70) ** 2 + (y - 100) ** 2) / 900)
        grey = (base - depth * blob + rng.normal(0, 0.8, base.shape)).clip(0, 255)
        difference = grey.astype(np.uint8).astype(int) - base.astype(np.uint8).astype(int)
        channels = [-7 * difference.clip(None, 0) % 256, 7 * difference.clip(0) % 256, grey]
        fingers.append(
            [bytes(imagecodecs.jpegxl_encode(c.astype(np.uint8), **_JPEGXL)) for c in channels]
        )
    return cameras, fingers


def make_buffer(path: Path, episodes: int, rows: int) -> None:
    """Write a buffer of so many episodes of so many rows."""
    from exumi_converters.umi.encoding import codec_config
    from exumi_converters.umi.sinks import ZipSink

    cameras, fingers = _pictures()
    codec = codec_config("jpegxl", tactile=False)
    total = episodes * rows
    numbers = {"eef_pos": 3, "eef_rot_axis_angle": 3, "gripper_width": 1}
    with ZipSink(path) as sink:

        def document(name: str, shape: list[int], chunks: list[int], dtype: str, how: Any) -> None:
            about = {
                "zarr_format": 2,
                "shape": shape,
                "chunks": chunks,
                "dtype": dtype,
                "compressor": how,
                "fill_value": 0,
                "order": "C",
                "filters": None,
            }
            sink.put(f"{name}/.zarray", json.dumps(about).encode())

        for group in ("", "data/", "meta/"):
            sink.put(f"{group}.zgroup", b'{"zarr_format": 2}')
        document("meta/episode_ends", [episodes], [episodes], "<i8", None)
        sink.put("meta/episode_ends/0", (np.arange(1, episodes + 1) * rows).tobytes())
        time_s = np.arange(total)[:, None] / 59.94
        for name, width in numbers.items():
            path_of = f"data/robot0_{name}"
            document(path_of, [total, width], [rows, width], "<f4", None)
            values = (0.05 + 0.03 * np.sin(time_s + np.arange(width))).astype(np.float32)
            for number in range(episodes):
                sink.put(f"{path_of}/{number}.0", values[number * rows :][:rows].tobytes())
        document("data/camera0_rgb", [total, SIZE, SIZE, 3], [1, SIZE, SIZE, 3], "|u1", codec)
        document("data/tactile_combined", [total, SIZE, SIZE, 3], [1, SIZE, SIZE, 1], "|u1", codec)
        for row in range(total):
            sink.put(f"data/camera0_rgb/{row}.0.0.0", cameras[row % _DISTINCT])
            for channel, content in enumerate(fingers[row % _DISTINCT]):
                sink.put(f"data/tactile_combined/{row}.0.0.{channel}", content)


def loop(path: Path) -> None:
    """Decode every chunk and code it as it is stored."""
    import imagecodecs
    import numcodecs

    from exumi_converters.zarr2_files.zip_index import Member, read_index, read_member
    from exumi_data.store import jpeg

    def members(table: np.ndarray) -> list[Member]:
        return [Member._make(record) for record in table.tolist()]

    index = read_index(path)
    zstd = numcodecs.Zstd()
    with path.open("rb") as file:
        camera = members(index.chunks["data/camera0_rgb", "0.0.0"])
        fingers = [members(index.chunks["data/tactile_combined", f"0.0.{c}"]) for c in range(3)]
        for row in range(len(camera)):
            data = read_member(file.fileno(), camera[row], path)
            jpeg.encode(imagecodecs.jpegxl_decode(data, numthreads=1), 95, chroma="444")
            for table in fingers:
                data = read_member(file.fileno(), table[row], path)
                zstd.encode(imagecodecs.jpegxl_decode(data, numthreads=1))


def convert_it(path: Path, target: Path) -> None:
    """Convert a buffer in this process."""
    from exumi_converters import ConvertOptions, convert

    shutil.rmtree(target, ignore_errors=True)
    done = convert(path, target, from_format="umi", options=ConvertOptions(workers=1))
    assert not done.failed  # noqa: S101  # a benchmark of a failure is none


def _alone(step: str, path: Path, target: Path) -> dict[str, Any]:
    """Run one step in a process of its own."""
    command = [
        sys.executable,
        __file__,
        "--step",
        step,
        "--work",
        str(target),
        "--buffer",
        str(path),
    ]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def _step(arguments: argparse.Namespace) -> None:
    import imagecodecs  # noqa: F401  # what is imported is not timed

    import exumi_converters  # noqa: F401

    start, cpu = time.perf_counter(), time.process_time()
    if arguments.step == "loop":
        loop(arguments.buffer)
    else:
        convert_it(arguments.buffer, arguments.work)
    seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": seconds, "cpu_s": cpu, "peak_mib": peak}))


def directory_memory(path: Path, members: int) -> dict[str, Any]:
    """Measure what the directory of a zip of so many members costs."""
    from exumi_converters.umi.sinks import ZipSink
    from exumi_converters.zarr2_files.zip_index import read_index

    with ZipSink(path) as sink:
        for row in range(members):
            sink.put(f"data/camera0_rgb/{row}.0.0.0", zlib.adler32(b"%d" % row).to_bytes(4, "big"))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    index = read_index(path)
    seconds = time.perf_counter() - start
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    found = sum(map(len, index.chunks.values()))
    path.unlink()
    return {
        "members": found,
        "seconds": round(seconds, 2),
        "bytes_a_member": round(grown * 1024 / found),
    }


def _ratios(runs: list[dict[str, Any]], what: str) -> dict[str, Any]:
    ratios = sorted(run["convert"][what] / run["loop"][what] for run in runs)
    return {
        "median": round(ratios[len(ratios) // 2], 3),
        "all": [round(ratio, 3) for ratio in ratios],
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rows", type=int, default=600, help="of an episode")
    parser.add_argument("--episodes", type=int, nargs=2, default=(2, 8), help="of the two buffers")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--members", type=int, default=1_000_000, help="of the zip's directory")
    parser.add_argument("--step", choices=("loop", "convert"), help=argparse.SUPPRESS)
    parser.add_argument("--buffer", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.step:
        _step(arguments)
        return
    machine = describe_machine(("exumi-data", "imagecodecs", "numcodecs", "numpy", "simplejpeg"))
    arguments.work.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"machine": machine, "rows_an_episode": arguments.rows, "buffers": {}}
    for episodes in arguments.episodes:
        buffer = arguments.work / f"buffer-{episodes}.zarr.zip"
        buffer.unlink(missing_ok=True)
        make_buffer(buffer, episodes, arguments.rows)
        runs = [
            {step: _alone(step, buffer, arguments.work / "out") for step in ("loop", "convert")}
            for _ in range(arguments.repeats)
        ]
        rows = episodes * arguments.rows
        best = min(run["convert"]["seconds"] for run in runs)
        results["buffers"][f"{episodes} episodes"] = {
            "mib": round(buffer.stat().st_size / 2**20, 1),
            "times_the_loop": _ratios(runs, "seconds"),
            "times_the_loop_cpu": _ratios(runs, "cpu_s"),
            "rows_per_s": round(rows / best),
            "peak_mib": round(max(run["convert"]["peak_mib"] for run in runs)),
        }
        buffer.unlink()
    results["directory"] = directory_memory(arguments.work / "directory.zip", arguments.members)
    report("convert_umi", results, arguments.json)


if __name__ == "__main__":
    main()
