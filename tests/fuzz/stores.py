"""What is spoiled: stores in memory, and how they are written to disk."""

import io
import json
import os
import zipfile
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from exumi_data.manifest import build_manifest
from exumi_data.model import Clock, EncodedImages, Frames, RawData
from exumi_data.model.documents import dump
from exumi_data.simulation import simulate_play
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack, packing_order
from tests.exumi_data.builders import (
    episode_id,
    metadata,
    write_dataset,
    write_episode,
    write_small,
)

__all__ = ["Draft", "Special", "Store", "all_stores", "as_zip", "unzipped"]

CORPUS = Path(__file__).resolve().parents[2] / "spec" / "conformance" / "1.0"


class Special(Enum):
    """What can stand in the place of a file."""

    LINK = "link"
    BROKEN_LINK = "broken link"
    LINK_TO_ITSELF = "link to itself"
    PIPE = "pipe"
    FOLDER = "folder"


@dataclass(frozen=True)
class Store:
    """A store as it should be: path to bytes; a zip's bytes are under the path ""."""

    name: str
    target: str
    files: dict[str, bytes]


@dataclass
class Draft:
    """A store that is being spoiled."""

    store: Store
    files: dict[str, bytes | Special]
    done: list[str] = field(default_factory=list)

    @property
    def is_zip(self) -> bool:
        """Whether it is one file."""
        return "" in self.files

    def paths(self, *suffixes: str) -> list[str]:
        """Return the paths of ordinary files, of some endings."""
        ordinary = (path for path, data in self.files.items() if isinstance(data, bytes))
        return sorted(path for path in ordinary if not suffixes or path.endswith(suffixes))

    def data(self, path: str) -> bytes:
        """Return the bytes of an ordinary file."""
        found = self.files[path]
        assert isinstance(found, bytes)
        return found

    def write(self, folder: Path) -> Path:
        """Write it below an empty folder."""
        target = folder / self.store.target
        for path, data in self.files.items():
            file = target / path if path else target
            try:
                file.parent.mkdir(parents=True, exist_ok=True)
                if isinstance(data, bytes):
                    file.write_bytes(data)
                else:
                    _make(file, data)
            except (FileExistsError, NotADirectoryError, IsADirectoryError):
                continue  # two files of which one is the other's folder
        return target


def _make(path: Path, special: Special) -> None:
    if special is Special.PIPE:
        os.mkfifo(path)
    elif special is Special.FOLDER:
        path.mkdir()
    else:
        targets = {Special.LINK: "/etc/hostname", Special.LINK_TO_ITSELF: path.name}
        path.symlink_to(targets.get(special, "nowhere"))


def as_zip(files: dict[str, bytes]) -> bytes:
    """Pack files as the standard says."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for path in packing_order(list(files)):
            archive.writestr(zipfile.ZipInfo(path, (1980, 1, 1, 0, 0, 0)), files[path])
    return buffer.getvalue()


def unzipped(data: bytes) -> dict[str, bytes]:
    """Return the members of a sound zip."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _load(name: str, path: Path) -> Store:
    if path.is_file():
        return Store(name, path.name, {"": path.read_bytes()})
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return Store(
        name, path.name, {file.relative_to(path).as_posix(): file.read_bytes() for file in files}
    )


def _simulated(path: Path) -> Path:
    """Write a play session of seconds: signals as sensors give them, with clocks and losses."""
    session = simulate_play(seed=3, duration_s=3.0, tactile_size=(32, 48), rgb_size=(32, 48))
    images: Any = {"height": 32, "width": 48, "channels": 3}
    fields: dict[str, dict[str, Any]] = {
        "pose": {"frames": Frames(parent="world", child="gripper")},
        "width": {"raw": RawData(unit="count", modulus=4096)},
    }
    with EpisodeWriter(path, metadata(7), durable=False) as writer:
        for stream in session.streams.values():
            extra = fields.get(stream.name) or {
                "images": EncodedImages(encoding="encoded", media_type="image/jpeg", **images)
            }
            clock = Clock(
                source="session",
                stamp_point="simulated",
                raw_time="time_host",
                latency_ns=stream.latency_ns,
            )
            rate = str(round(stream.rate_hz))
            out = writer.add_stream(
                stream.name, kind=stream.kind, clock=clock, nominal_rate=rate, **extra
            )
            beside: dict[str, Any] = {
                "time_host": stream.time_ns,
                "sequence": stream.sequence.astype("uint64"),
            }
            values: Any = stream.data
            if values is None:
                values = [jpeg.encode(stream.render(i), 90) for i in range(len(stream))]
            if stream.raw is not None:
                beside["raw"] = stream.raw
            out.append(stream.capture_time_ns, values, **beside)
            if stream.reference is not None:
                out.set_reference(stream.reference, method="captured", contact_free=True)
    return path


def _made(folder: Path) -> list[Store]:
    """Return stores that our own writers made."""
    whole = write_episode(folder / "whole.zarr")
    small = write_small(folder / "small.zarr", 1)
    dataset = write_dataset(folder / "dataset", 2, splits=["default"])
    split = {
        "format": "exumi-split",
        "version": "1.0",
        "name": "default",
        "level": "episode",
        "lists": {"train": [episode_id(0)], "val": [episode_id(1)]},
    }
    (dataset / "splits").mkdir()
    (dataset / "splits" / "default.json").write_text(json.dumps(split))
    (dataset / "manifest.json").write_text(json.dumps(dump(build_manifest(dataset))))
    simulated = _simulated(folder / "simulated.zarr")
    paths = [whole, pack(whole), small, pack(small), dataset, simulated]
    return [_load(f"made {path.name}", path) for path in paths]


def all_stores() -> list[Store]:
    """Return all stores that are spoiled, always in the same order."""
    found = []
    for expected in sorted(CORPUS.glob("valid/*/expected.json")):
        target = json.loads(expected.read_text("utf-8"))["store"]
        found.append(_load(expected.parent.name, expected.parent / target))
    with TemporaryDirectory() as folder:
        made = _made(Path(folder))
    # What our writers make holds most, so it is taken more often.
    return found + made * 5
