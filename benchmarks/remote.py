"""Windows per second of TPPWindows from an S3 server on localhost with latency, cold, small cache.

The set is packed into WORK and served by moto behind a proxy that delays every request. Everything
that is kept, on the disk and in the memory of all processes, is at most a share of the set. The
same windows from the disk are measured beside it::

    python benchmarks/remote.py --dataset WORK/windows-grey --work WORK --json results/remote.json
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

from measuring import describe_machine, report

from exumi_data.store.remote.reading import memory_bytes

SERVER = Path(__file__).with_name("remote_server.py")


def packed_copy(source: Path, work: Path) -> Path:
    """Pack a dataset's episodes, unless that is done."""
    from exumi_data.catalog import build_catalog, write_catalog
    from exumi_data.store.pack import pack

    target = work / f"{source.name}-packed"
    if (target / "catalog.parquet").exists():
        return target
    for episode in sorted(source.glob("episodes/*/*.zarr")):
        packed = target / f"{episode.relative_to(source)}.zip"
        packed.parent.mkdir(parents=True, exist_ok=True)
        if not packed.exists():
            pack(episode, packed)
    for name in ("dataset.json", "splits"):
        if (source / name).is_dir():
            shutil.copytree(source / name, target / name, dirs_exist_ok=True)
        elif (source / name).exists():
            shutil.copy(source / name, target / name)
    table, failed = build_catalog(target)
    if failed:
        raise SystemExit(f"episodes cannot be read: {failed}")
    write_catalog(target, table)
    return target


def cache_bytes(room: int, processes: int) -> int:
    """Return what the disk may keep, so that with the memory of all processes it fits the room."""
    found = room
    while found > 0 and found + processes * memory_bytes(found) > room:
        found -= room // 1000
    if found <= 0:
        raise SystemExit("the set is too small: the memory of the processes alone is a larger part")
    return found


class Passed:
    """What passed through the proxy since the last look."""

    def __init__(self, url: str) -> None:
        self._url = f"{url}/-/counts"
        self._last = self._now()

    def _now(self) -> dict[str, int]:
        with urllib.request.urlopen(self._url) as answer:  # noqa: S310  # our own server
            counts: dict[str, int] = json.load(answer)
        return counts

    def since(self) -> dict[str, int]:
        """Return requests and bytes since the last call."""
        before, self._last = self._last, self._now()
        return {name: value - before[name] for name, value in self._last.items()}


def windows_of(source: str) -> Any:
    """Open the training set as windows, as exUMI trains on them; no timeline is cached."""
    import exumi_data
    from exumi_loaders import TPPWindows

    dataset = exumi_data.open(source)
    if not isinstance(dataset, exumi_data.Dataset):
        raise SystemExit(f"{source} is no dataset")
    return TPPWindows(dataset, cache=False)


def load(windows: Any, arguments: argparse.Namespace) -> dict[str, float]:
    """Load windows in an order of chance; the workers' start counts."""
    start = time.perf_counter()
    done, first = 0, 0.0
    batches = windows.loader(arguments.batch, shuffle=True, num_workers=arguments.workers)
    for batch in batches:
        done += len(batch["valid"])
        first = first or time.perf_counter() - start
        if done >= arguments.windows:
            break
    seconds = time.perf_counter() - start
    return {"windows": done, "seconds": seconds, "first_batch_s": round(first, 2)}


def run_remote(folder: Path, url: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure from the server: what opening takes, and what windows take."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    processes = arguments.workers + 1
    kept = cache_bytes(round(size * arguments.cache_share), processes)
    cache = arguments.work / "remote-cache"
    shutil.rmtree(cache, ignore_errors=True)
    os.environ |= {
        "AWS_ENDPOINT_URL": url,
        "AWS_ACCESS_KEY_ID": "benchmark",
        "AWS_SECRET_ACCESS_KEY": "benchmark",
        "AWS_REGION": "us-east-1",
        "EXUMI_CACHE": str(cache),
        "EXUMI_CACHE_BYTES": str(kept),
    }
    passed = Passed(url)
    start = time.perf_counter()
    windows = windows_of(f"s3://datasets/{folder.name}")
    opening_s = time.perf_counter() - start
    opening = passed.since()
    loaded = load(windows, arguments)
    loading = passed.since()
    count = loaded["windows"]
    memory = processes * memory_bytes(kept)
    on_disk = sum(path.stat().st_blocks * 512 for path in cache.rglob("*") if path.is_file())
    return {
        "set_bytes": size,
        "episodes": len(windows.episodes),
        "cache": {
            "disk_limit": kept,
            "on_disk": on_disk,
            "memory_of_all_processes": memory,
            "share_of_set": round((on_disk + memory) / size, 4),
        },
        "opening": {"seconds": round(opening_s, 2), **opening},
        "windows": count,
        "first_batch_s": loaded["first_batch_s"],
        "windows_per_s": round(count / loaded["seconds"], 1),
        "windows_per_s_with_opening": round(count / (loaded["seconds"] + opening_s), 1),
        "requests_per_window": round(loading["requests"] / count, 3),
        "requests_per_window_with_opening": round(
            (loading["requests"] + opening["requests"]) / count, 3
        ),
        "kib_per_window": round(loading["bytes"] / count / 1024, 1),
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True, help="a training set in folders")
    parser.add_argument("--work", type=Path, required=True, help="where to keep what is built")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--windows", type=int, default=8000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--latency", type=float, default=0.02, help="seconds for each request")
    parser.add_argument("--cache-share", type=float, default=0.1, help="of the set, all processes")
    arguments = parser.parse_args()
    folder = packed_copy(arguments.dataset, arguments.work)
    machine = describe_machine(("exumi-data", "obstore", "moto", "torch"))
    local = load(windows_of(str(folder)), arguments)
    command = [sys.executable, str(SERVER), str(folder), "--latency", str(arguments.latency)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as server:
        try:
            assert server.stdout is not None  # noqa: S101  # a pipe
            url = json.loads(server.stdout.readline())["url"]
            remote = run_remote(folder, url, arguments)
        finally:
            server.terminate()
    result = {
        "machine": machine,
        "settings": {
            "latency_s": arguments.latency,
            "workers": arguments.workers,
            "batch": arguments.batch,
        },
        "remote": remote,
        "local_windows_per_s": round(local["windows"] / local["seconds"], 1),
    }
    report("remote", result, arguments.json)


if __name__ == "__main__":
    main()
