"""Opening a dataset from its catalog, and building the window index, cold and from the cache.

::

    python benchmarks/opening.py --dataset PREPARED --work FOLDER --json results/opening.json
"""

import argparse
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

from measuring import describe_machine, report

IMPORT_AND_OPEN = """
import sys, time
start = time.perf_counter()
import exumi_data
exumi_data.open(sys.argv[1])
print(time.perf_counter() - start)
"""


def main() -> None:
    """Run the benchmark."""
    from exumi_data.dataset import open_dataset
    from exumi_loaders import TPPWindows

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "numpy", "pyarrow", "torch"))
    cache = arguments.work / "index-cache"
    dataset = open_dataset(arguments.dataset)  # pyarrow is imported here, before the clock starts
    TPPWindows(dataset[:1], cache=False)  # and SciPy here
    opening, cold, cached, process = [], [], [], []
    for _ in range(arguments.repeats):
        start = time.perf_counter()
        dataset = open_dataset(arguments.dataset)
        opening.append(time.perf_counter() - start)
        shutil.rmtree(cache, ignore_errors=True)
        start = time.perf_counter()
        windows = TPPWindows(dataset, cache=cache)
        cold.append(time.perf_counter() - start)
        start = time.perf_counter()
        TPPWindows(dataset, cache=cache)
        cached.append(time.perf_counter() - start)
        command = [sys.executable, "-c", IMPORT_AND_OPEN, str(arguments.dataset)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        process.append(float(done.stdout))
    times = {
        "open_s": opening,
        "import_and_open_in_a_new_process_s": process,
        "window_index_cold_s": cold,
        "window_index_cached_s": cached,
    }
    results = {
        "machine": machine,
        "episodes": len(dataset),
        "windows": len(windows),
        **{
            name: {"median": round(statistics.median(v), 4), "all": [round(x, 4) for x in v]}
            for name, v in times.items()
        },
    }
    report("opening", results, arguments.json)


if __name__ == "__main__":
    main()
