"""Accepted windows per second: `ActiveWindowSampler` against a loop that decodes and rejects.

Both give windows of the same distribution, made by the same code, in the same process. The loop
draws windows, decodes them, rejects inactive ones with some probability, and draws again for these.
Whether a window that it decoded is active it is told from the index, which costs it nothing. The
threshold of activity is chosen so that a tenth of all windows are active::

    python benchmarks/sampling.py --dataset WORK/windows-grey --json results/sampling.json
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, one_core, report, timed

ACTIVE = 0.1


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--windows", type=int, default=2000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "numpy", "simplejpeg", "torch"))
    one_core()
    import torch

    torch.set_num_threads(1)
    windows = _windows(arguments.dataset)
    results: dict[str, Any] = {
        "machine": machine,
        "windows": len(windows),
        "active_share": round(float(windows.active.mean()), 4),
    }
    for name, reject, retries in (("exumi_0.9_5", 0.9, 5), ("every_window_active", 1.0, None)):
        results[name] = _compare(windows, reject, retries, arguments)
    report("sampling", results, arguments.json)


def _windows(dataset: Path) -> Any:
    """Windows of which a tenth are active: the threshold is searched by halving."""
    from exumi_data.dataset import open_dataset
    from exumi_loaders import TPPWindows

    opened = open_dataset(dataset)
    low, high, some = 0.0, 1.0, opened[:64]
    for _ in range(16):
        middle = (low + high) / 2
        share = TPPWindows(some, active_above=middle, cache=False).active.mean()
        low, high = (middle, high) if share > ACTIVE else (low, middle)
    return TPPWindows(opened, active_above=high, cache=False)


def _compare(
    windows: Any, reject: float, retries: int | None, arguments: argparse.Namespace
) -> dict[str, Any]:
    from exumi_loaders import ActiveWindowSampler

    count, batch = arguments.windows, arguments.batch
    sampler = ActiveWindowSampler(windows, reject=reject, retries=retries, count=count)

    def ours() -> int:
        return sum(len(item["valid"]) for item in windows.loader(batch, sampler=sampler))

    loop = partial(_decode_and_reject, windows, reject, retries, count, batch)
    rates = {"sampler": timed(ours, 1), "loop": timed(loop, 1)}  # once, for buffers and caches
    rates = {"sampler": timed(ours, arguments.repeats), "loop": timed(loop, arguments.repeats)}
    ratio = rates["sampler"]["median"] / rates["loop"]["median"]
    return {"windows_per_s": rates, "ratio": round(ratio, 2)}


def _decode_and_reject(
    windows: Any, reject: float, retries: int | None, count: int, batch: int
) -> int:
    """Draw, decode, reject, draw again; whole batches at a time, as fast as that can be done."""
    rng, active, kept = np.random.default_rng(0), windows.active, 0
    while kept < count:
        missing, tries = batch, 0
        while missing:
            drawn = rng.integers(len(windows), size=missing)
            windows.__getitems__(drawn.tolist())
            rejected = ~active[drawn] & (rng.random(missing) < reject)
            if retries is not None and tries == retries:
                rejected[:] = False
            missing, tries = int(rejected.sum()), tries + 1
        kept += batch
    return kept


if __name__ == "__main__":
    main()
