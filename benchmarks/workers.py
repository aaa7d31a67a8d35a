"""What a second worker brings: the loader's windows per second, and a loop that only decodes.

The loop decodes the JPEGs of whole episodes in one process and in two; the loader has one worker
and two. The memory of each worker is read four times on the way: what is its own, and what it
shares with this process to hand batches over::

    python benchmarks/workers.py --dataset WORK/windows-grey --json results/workers.json
"""

import argparse
import itertools
import time
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

MIB = 1 << 20


def main() -> None:
    """Run the benchmark."""
    from exumi_data.dataset import open_dataset
    from exumi_loaders import TPPWindows

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--windows", type=int, default=8000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "numpy", "simplejpeg", "torch"))
    dataset = open_dataset(arguments.dataset)
    windows = TPPWindows(dataset, cache=False)
    paths = [dataset.episode_location(index) for index in range(len(dataset))]
    rates: dict[str, list[float]] = {f"{a}_{n}": [] for a in ("loader", "decoding") for n in (1, 2)}
    memory: dict[str, list[list[float]]] = {"private": [], "shared": []}
    for _ in range(arguments.repeats):  # in turns: all see the same neighbours on the machine
        for number in (1, 2):
            rate, used = _loader(windows, number, arguments)
            rates[f"loader_{number}"].append(rate)
            for kind, rows in used.items():
                memory[kind] += rows
            rates[f"decoding_{number}"].append(_decoding(paths, number))
    gain = {
        name: np.median(rates[f"{name}_2"]) / np.median(rates[f"{name}_1"])
        for name in ("loader", "decoding")
    }
    results = {
        "machine": machine,
        "per_s": {name: [round(value, 1) for value in values] for name, values in rates.items()},
        "gain_of_two": {name: round(float(value), 3) for name, value in gain.items()},
        "ratio": round(float(gain["loader"] / gain["decoding"]), 3),
        **{f"worker_{kind}_mib": rows for kind, rows in memory.items()},
    }
    report("workers", results, arguments.json)


def _loader(
    windows: Any, number: int, arguments: argparse.Namespace
) -> tuple[float, dict[str, list[list[float]]]]:
    """Return windows a second once the workers run, and MiB of each worker on the way."""
    options = {"num_workers": number, "persistent_workers": True}
    loader = windows.loader(arguments.batch, **options)
    used: dict[str, list[list[float]]] = {
        kind: [[] for _ in range(number)] for kind in ("private", "shared")
    }
    batches = iter(loader)
    for _ in range(4 * number):  # the workers have started, and opened what they need
        next(batches)
    done, start = 0, time.perf_counter()
    for done in range(arguments.batch, arguments.windows + 1, arguments.batch):
        next(batches)
        if done % (arguments.windows // 4 // arguments.batch * arguments.batch) == 0:
            for place, worker in enumerate(batches._workers):
                used["private"][place].append(round(_private(worker.pid) / MIB, 1))
                used["shared"][place].append(round(_shared(worker.pid) / MIB, 1))
    rate = done / (time.perf_counter() - start)
    batches._shutdown_workers()
    return rate, used


def _private(pid: int) -> int:
    """Bytes of a process that are its own: neither of files nor shared with its parent."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="utf-8")
    lines = (line.split() for line in text.splitlines()[1:])
    kib = {words[0].rstrip(":"): int(words[1]) for words in lines}
    return kib["Pss_Anon"] * 1024


def _shared(pid: int) -> int:
    """Bytes of shared memory that a process has, whoever else has it."""
    size, counts = 0, False
    for line in Path(f"/proc/{pid}/smaps").read_text(encoding="utf-8").splitlines():
        words = line.split()
        if not words[0].endswith(":"):
            counts = len(words) > 5 and "/torch_" in words[5]
        elif counts and words[0] == "Rss:":
            size += int(words[1]) * 1024
    return size


def _decoding(paths: list[str], number: int) -> float:
    """Return frames a second of all processes, decoding every episode's files."""
    context = get_context("fork")
    shares = [paths[start::number] for start in range(number)]
    with context.Pool(number) as pool:
        pool.map(_warm, shares)
        start = time.perf_counter()
        done = sum(pool.map(_decode, shares, chunksize=1))
        return done / (time.perf_counter() - start)


def _warm(paths: list[str]) -> None:
    _decode(paths[:1])


def _decode(paths: list[str]) -> int:
    from exumi_data.episode import open_episode
    from exumi_data.store import jpeg

    count = 0
    for path in paths:
        with open_episode(path) as episode:
            for stream in episode:
                images = getattr(episode[stream].metadata, "images", None)
                if images is None or images.encoding != "encoded":
                    continue
                out = np.empty((images.height, images.width, images.channels), np.uint8)
                files = map(partial(_file, episode[stream]), range(len(episode[stream])))
                for data in itertools.chain(files):
                    jpeg.decode_into(data, out)
                    count += 1
    return count


def _file(stream: Any, index: int) -> bytes:
    return bytes(stream.encoded(index))


if __name__ == "__main__":
    main()
