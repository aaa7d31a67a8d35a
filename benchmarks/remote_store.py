"""Whether a dataset in a bucket is read as the local one is, on any server: S3, GCS, Azure.

Credentials and endpoints come from the environment, as docs/object-storage.md says. With
``--upload`` the files are put there first::

    python benchmarks/remote_store.py training az://container/training --upload
"""

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np

import exumi_data
from exumi_data.store.remote.address import Address
from exumi_loaders import TPPWindows


def _upload(folder: Path, url: str) -> None:
    import obstore

    from exumi_data.store.remote.requests import store_of

    address = Address.parse(url)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            key = address.below(path.relative_to(folder).as_posix()).key
            obstore.put(store_of(address), key, path.read_bytes())


def _dataset(source: str) -> exumi_data.Dataset:
    opened = exumi_data.open(source)
    if not isinstance(opened, exumi_data.Dataset):
        raise SystemExit(f"{source} is no dataset")
    return opened


def _windows(source: str, workers: int) -> dict[int, bytes]:
    windows = TPPWindows(_dataset(source), rgb=(), pose=(), width=())
    found: dict[int, bytes] = {}
    for batch in windows.loader(batch_size=32, num_workers=workers, shuffle=False):
        found[len(found)] = np.asarray(batch["tactile"]).tobytes()
    return found


def main() -> None:
    """Compare, and print what was read in which time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("url")
    parser.add_argument("--upload", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    os.environ["EXUMI_CACHE_BYTES"] = "0"
    if arguments.upload:
        _upload(arguments.folder, arguments.url)
    here, there = _dataset(str(arguments.folder)), _dataset(arguments.url)
    for mine, theirs in zip(here, there, strict=True):
        theirs.check_complete()
        for name, stream in mine.streams.items():
            np.testing.assert_array_equal(theirs[name].time, stream.time)
    start = time.perf_counter()
    remote = _windows(arguments.url, arguments.workers)
    seconds = time.perf_counter() - start
    same = remote == _windows(str(arguments.folder), 0)
    print(
        json.dumps(
            {
                "url": Address.parse(arguments.url).shown,
                "episodes": len(there),
                "batches": len(remote),
                "seconds": round(seconds, 2),
                "same": same,
            }
        )
    )


if __name__ == "__main__":
    main()
