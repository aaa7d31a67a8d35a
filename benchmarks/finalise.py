"""Finalising a journal, and beside it the bare limit: copy, SHA-256 and fsync of the same bytes.

The journal is one that ``recording.py --keep`` left. Each run works on a copy of its own::

    python benchmarks/recording.py --work FOLDER --seconds 60 --keep
    python benchmarks/finalise.py --work FOLDER --json results/finalise.json
"""

import argparse
import hashlib
import os
import resource
import shutil
import statistics
import time
from pathlib import Path
from typing import Any

from measuring import describe_machine, report

from exumi_data.dataset import create_dataset
from exumi_data.model import DatasetMetadata
from exumi_recorders.finalise.episode import finalise
from exumi_recorders.journal.states import list_journals

_PIECE = 4 << 20


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    (journal,) = list_journals(arguments.work / "recording" / "dataset")
    logs = sorted(journal.rglob("*.log"))
    size = sum(path.stat().st_size for path in logs)
    machine = describe_machine(("exumi-data", "numpy", "google-crc32c"))
    copies, finals = [], []
    for number in range(arguments.repeats):
        copies.append(_copy(logs, arguments.work / "copied"))
        finals.append(_finalise(journal, arguments.work / f"finalised-{number}"))
    results: dict[str, Any] = {
        "machine": machine,
        "bytes_mb": round(size / 1e6, 1),
        "copy_sha256_fsync_mb_per_s": _rates(size, copies),
        "finalise_mb_per_s": _rates(size, finals),
        "ratio": round(statistics.median(copies) / statistics.median(finals), 3),
        "peak_rss_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }
    report("finalise", results, arguments.json)


def _rates(size: int, seconds: list[float]) -> dict[str, Any]:
    rates = [size / 1e6 / each for each in seconds]
    return {"median": round(statistics.median(rates), 1), "all": [round(each, 1) for each in rates]}


def _copy(logs: list[Path], target: Path) -> float:
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir()
    os.sync()
    start = time.perf_counter()
    for number, path in enumerate(logs):
        state = hashlib.sha256()
        with path.open("rb") as source, (target / str(number)).open("wb") as copy:
            while piece := source.read(_PIECE):
                state.update(piece)
                copy.write(piece)
            copy.flush()
            os.fsync(copy.fileno())
    took = time.perf_counter() - start
    shutil.rmtree(target)
    return took


def _finalise(journal: Path, dataset: Path) -> float:
    shutil.rmtree(dataset, ignore_errors=True)
    create_dataset(dataset, DatasetMetadata(name="finalised", licence="CC0-1.0"))
    own = dataset / ".recording" / journal.name
    shutil.copytree(journal, own)
    os.sync()
    start = time.perf_counter()
    outcome = finalise(own).outcome
    took = time.perf_counter() - start
    if outcome != "finalised":
        raise SystemExit(f"the journal was not finalised but {outcome}")
    shutil.rmtree(dataset)
    return took


if __name__ == "__main__":
    main()
