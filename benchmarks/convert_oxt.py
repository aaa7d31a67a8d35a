"""Episodes to Open-X-Tactile stores and back: speed against a loop that only codes, and memory.

The episodes are simulated (`exumi demo --direct`): a camera and two tactile sensors in JPEG. The
loop does what a conversion cannot do without: decode each frame, and compress it as it is stored;
back, the other way round. All run in one process. Times are by the clock and by the processor time
of the process. Memory is the peak of a process that does nothing else, for two lengths.

::

    python benchmarks/convert_oxt.py --work FOLDER --json results/convert_oxt.json
"""

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

_LENGTHS_S = (10, 40)


def _demo(folder: Path, seconds: int) -> Path:
    if not (folder / "dataset").is_dir():
        shutil.rmtree(folder, ignore_errors=True)
        told = ["--direct", "--out", str(folder), "--seconds", str(seconds), "--quiet"]
        subprocess.run(["exumi", "demo", *told], check=True, stdout=subprocess.DEVNULL)
    return folder / "dataset"


def _export(source: Path, target: Path) -> int:
    from exumi_converters.exporter import ExportOptions
    from exumi_converters.exporting import export

    options = ExportOptions(workers=1, durable=False)
    return 3 * export(source, target, to_format="oxt", options=options).frames


def _import(source: Path, target: Path) -> int:
    from exumi_converters import ConvertOptions, convert

    options = ConvertOptions(workers=1, durable=False)
    return convert(source, target, from_format="oxt", options=options).frames


def _loop_out(source: Path, _: Path) -> int:
    from numcodecs import Zstd

    import exumi_data

    codec, count = Zstd(level=3), 0
    dataset: Any = exumi_data.open(source)
    for episode in dataset:
        for name in ("rgb", "tactile_left", "tactile_right"):
            for frame in episode[name].frames:
                codec.encode(np.ascontiguousarray(frame))
                count += 1
    return count


def _loop_back(source: Path, _: Path) -> int:
    import zarr
    from numcodecs import Zstd

    codec, count = Zstd(level=3), 0
    for path in sorted(source.glob("*.zarr")):
        root: Any = zarr.open_group(str(path), mode="r", zarr_format=2)
        for key in ("right_wrist_camera_rgb", "right_tactile_data_gripper"):
            array = root["data"][key]
            for step in range(array.shape[0]):
                for frame in np.reshape(array[step], (-1, *array.shape[-3:])):
                    codec.encode(np.ascontiguousarray(frame))
                    count += 1
    return count


_WORK = {"to_oxt": _export, "from_oxt": _import, "loop_out": _loop_out, "loop_back": _loop_back}


def _child(what: str, source: Path, target: Path) -> None:
    """Do one thing and print what it took."""
    start, used = time.perf_counter(), time.process_time()
    frames = _WORK[what](source, target)
    print(
        json.dumps(
            {
                "frames": frames,
                "frames_per_s": round(frames / (time.perf_counter() - start), 1),
                "frames_per_cpu_s": round(frames / (time.process_time() - used), 1),
                "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
            }
        )
    )


def _run(what: str, source: Path, target: Path) -> dict[str, Any]:
    shutil.rmtree(target, ignore_errors=True)
    told = ["--child", what, "--source", str(source), "--work", str(target)]
    done = subprocess.run(
        [sys.executable, __file__, *told], check=True, capture_output=True, text=True
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--lengths", type=int, nargs="+", default=list(_LENGTHS_S), help="seconds")
    parser.add_argument("--child", choices=tuple(_WORK), help=argparse.SUPPRESS)
    parser.add_argument("--source", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        _child(arguments.child, arguments.source, arguments.work)
        return
    results: dict[str, Any] = {"machine": describe_machine(("exumi-data", "numcodecs", "zarr"))}
    for seconds in arguments.lengths:
        dataset = _demo(arguments.work / f"demo-{seconds}", seconds)
        stores, back = arguments.work / f"oxt-{seconds}", arguments.work / f"back-{seconds}"
        found = {
            "loop_out": _run("loop_out", dataset, back),
            "to_oxt": _run("to_oxt", dataset, stores),
            "loop_back": _run("loop_back", stores, back),
            "from_oxt": _run("from_oxt", stores, back),
        }
        results[f"{seconds}_s"] = found
        for what, values in found.items():
            rates = (
                f"{values['frames_per_cpu_s']:8.1f} /cpu s  {values['frames_per_s']:8.1f} frames/s"
            )
            print(f"{seconds:4d} s  {what:10s} {rates}  peak {values['peak_mb']} MB")
    report("convert_oxt", results, arguments.json)


if __name__ == "__main__":
    main()
