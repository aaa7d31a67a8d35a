#!/usr/bin/env python3
"""Print the canonical dump of an episode or a dataset, as `exumi_data` reads it.

Exit code 0: printed. 1: refused, with one line that says why. See ``spec/readers/README.md``.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.catalog import list_episodes
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.episode import Episode, StreamView, open_episode
from exumi_data.errors import DamagedDataError, ExumiError
from exumi_data.model import ArrayImages, EncodedImages, VideoImages
from exumi_data.model.documents import parse_dataset, parse_split
from exumi_data.store.shards import ArrayReader, crc32c, open_array

BLOCK_BYTES = 16 << 20
BLOCKS = 4
BLOCK_SIDE = 8


def sha256(data: bytes) -> str:
    """Return the sha-256 of some bytes."""
    return hashlib.sha256(data).hexdigest()


def dump_array(array: ArrayReader) -> dict[str, Any]:
    """Return what the dump says of an array, reading it block by block."""
    count, *row = array.shape
    step = max(1, BLOCK_BYTES // max(1, array.dtype.itemsize * int(np.prod(row))))
    state = hashlib.sha256()
    for start in range(0, count, step):
        rows = array.rows(start, min(count, start + step))
        state.update(rows.astype(rows.dtype.newbyteorder("<"), copy=False).tobytes())
    return {
        "dtype": array.dtype.name,
        "shape": list(array.shape),
        "sha256": state.hexdigest(),
    }


def chosen(count: int) -> list[int]:
    """Return the first, the middle and the last index."""
    return sorted({0, count // 2, count - 1}) if count else []


def edges(length: int) -> Iterator[tuple[int, int]]:
    """Yield where the blocks of an axis begin and end."""
    blocks = max(1, min(BLOCKS, length // BLOCK_SIDE))
    for k in range(blocks):
        yield k * length // blocks, (k + 1) * length // blocks


def block_means(frame: np.ndarray) -> list[list[int]]:
    """Return the mean of each channel in up to 4 by 4 blocks, row by row."""
    height, width, _ = frame.shape
    means = [
        frame[top:bottom, left:right].mean(axis=(0, 1))
        for top, bottom in edges(height)
        for left, right in edges(width)
    ]
    return [[round(float(value)) for value in mean] for mean in means]


def dump_frames(stream: StreamView) -> list[dict[str, Any]]:
    """Return what the dump says of frames that are stored one by one."""
    found: list[dict[str, Any]] = []
    encoded = isinstance(getattr(stream.metadata, "images", None), EncodedImages)
    if encoded:
        check_frames(stream)
    for index in chosen(len(stream)):
        frame = stream.frames[index]
        if not encoded:
            found.append({"index": index, "sha256": sha256(frame.tobytes())})
            continue
        height, width, channels = frame.shape
        found.append(
            {
                "index": index,
                "sha256": sha256(stream.encoded(index)),
                "height": height,
                "width": width,
                "channels": channels,
                "blocks": block_means(frame),
            }
        )
    return found


def check_frames(stream: StreamView) -> None:
    """Refuse a stream of which a frame has another checksum."""
    checksums = stream.array("crc32c")
    for index in range(len(stream)):
        if crc32c(stream.encoded(index)) != checksums[index]:
            raise DamagedDataError(f"frame {index} has a wrong checksum", where=stream.name)


def dump_images(stream: StreamView) -> dict[str, Any]:
    """Return what the dump says of the images of a stream."""
    images: ArrayImages | EncodedImages | VideoImages = stream.metadata.images  # type: ignore[attr-defined]  # the caller asked
    if not isinstance(images, VideoImages):
        return {"encoding": images.encoding, "frames": dump_frames(stream)}
    files = []
    for index, file in enumerate(images.files):
        content = stream.container(index)
        files.append({"name": file.name, "bytes": len(content), "sha256": sha256(content)})
    return {"encoding": images.encoding, "files": files}


def dump_stream(episode: Episode, stream: StreamView) -> dict[str, Any]:
    """Return the dump of a stream."""
    arrays = []
    for name in sorted(stream.metadata.arrays):
        array = open_array(episode.store, f"streams/{stream.name}/{name}")
        arrays.append({"name": name, **dump_array(array)})
    dump = {"name": stream.name, "kind": stream.kind, "count": len(stream), "arrays": arrays}
    return dump | ({"images": dump_images(stream)} if stream.is_image else {})


def dump_episode(path: Path) -> dict[str, Any]:
    """Return the dump of an episode."""
    with open_episode(path) as episode:
        episode.check_complete()
        items = episode.metadata.calibration.values()
        others = [item.array for item in items if item.array is not None]
        others += [f"derived/{key}" for key in (episode.derived.items if episode.derived else ())]
        return {
            "dump": 1,
            "format": "exumi-episode",
            "version": episode.metadata.version,
            "id": episode.id,
            "digest": episode.digest(),
            "streams": [dump_stream(episode, stream) for stream in episode.streams.values()],
            "arrays": [
                {"path": name, **dump_array(open_array(episode.store, name))}
                for name in sorted(others)
            ],
        }


def dump_dataset(root: Path) -> dict[str, Any]:
    """Return the dump of a dataset."""
    document = root / DATASET_DOCUMENT
    metadata = parse_dataset(document.read_bytes(), document)
    splits = []
    for name in sorted(metadata.splits):
        path = root / "splits" / f"{name}.json"
        splits.append({"name": name, "lists": parse_split(path.read_bytes(), path).lists})
    episodes = [dump_episode(root / path) for path in list_episodes(root)]
    return {
        "dump": 1,
        "format": "exumi-dataset",
        "version": metadata.version,
        "name": metadata.name,
        "splits": splits,
        "episodes": sorted(episodes, key=lambda episode: str(episode["id"])),
    }


def dump_store(store: Path) -> dict[str, Any]:
    """Return the dump of an episode or a dataset."""
    is_dataset = (store / DATASET_DOCUMENT).is_file()
    return dump_dataset(store) if is_dataset else dump_episode(store)


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("store", type=Path, metavar="STORE")
    store: Path = parser.parse_args().store
    try:
        dump = dump_store(store)
    except (ExumiError, OSError) as error:
        sys.stderr.write(f"refused: {' '.join(str(error).split())}\n")
        return 1
    sys.stdout.write(json.dumps(dump, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
