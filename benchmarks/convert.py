"""Frames per second of converting and preparing the PhysiCLeAR clips, on all cores.

::

    python benchmarks/convert.py --real DATA --work FOLDER --json results/convert.json
"""

import argparse
import shutil
import time
from pathlib import Path
from typing import Any

from measuring import describe_machine, report


def main() -> None:
    """Run the benchmark."""
    import exumi_converters as converters
    from exumi_data.engine import default_workers

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", type=Path, required=True, help="folder with physiclear/")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "av", "numpy", "opencv-contrib-python-headless"))
    source = arguments.real / "physiclear"
    native, prepared = arguments.work / "bench-native", arguments.work / "bench-prepared"
    rates: dict[str, list[float]] = {"convert": [], "prepare": [], "prepare_gray": []}
    frames = 0
    for _ in range(arguments.repeats):
        shutil.rmtree(native, ignore_errors=True)
        options = converters.ConvertOptions(
            labels=source / "labels.csv", licence="LicenseRef-benchmark", keep_going=True
        )
        start = time.perf_counter()
        done: Any = converters.convert(
            source / "videos", native, from_format="octopi", options=options
        )
        frames = done.frames
        rates["convert"].append(frames / (time.perf_counter() - start))
        for name, gray in (("prepare", False), ("prepare_gray", True)):
            shutil.rmtree(prepared, ignore_errors=True)
            start = time.perf_counter()
            converters.prepare(native, prepared, gray=gray)
            rates[name].append(frames / (time.perf_counter() - start))
    results: dict[str, Any] = {"machine": machine, "workers": default_workers(), "frames": frames}
    for name, values in rates.items():
        ordered = sorted(values)
        results[f"{name}_frames_per_s"] = {
            "median": round(ordered[len(ordered) // 2]),
            "all": [round(value) for value in values],
        }
    report("convert", results, arguments.json)


if __name__ == "__main__":
    main()
