#!/usr/bin/env python3
"""Write files of this version as our writers make them today, for later versions to read.

Run once for each version of the format, before its release. What is there is never written again:
the program refuses to. Each case has the layout of the conformance corpus, and its canonical dump.
"""

import argparse
import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data import __version__
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.model import (
    Annotations,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Images,
    RawData,
    Sensor,
    Source,
    Task,
)
from exumi_data.model.documents import dump, parse_dataset
from exumi_data.model.images import ArrayImages
from exumi_data.simulation import PlaySession, SimulatedStream, simulate_play
from exumi_data.splits import make_split
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack
from exumi_data.tactile import ACTIVE_THRESHOLD, ACTIVITY_METHOD, ActivityMeter

SPEC = Path(__file__).resolve().parents[1]
VERSION = "1.0"
HERE = SPEC / "frozen" / VERSION
FRAMES = 5
SIZE = (32, 48)
# Cases of the corpus that are written by our writer, too.
FROM_CORPUS = (
    "extension__kind_and_keys",
    "images__array_zstd",
    "images__video",
    "source__converted_with_labels",
    "streams__none",
    "taxels__mask_and_positions",
    "time__clock_corrected",
    "time__nominal_rate",
    "wrench__one_component",
)


def metadata(number: int, session: PlaySession) -> EpisodeMetadata:
    """Return the metadata of a simulated episode."""
    encoder = session.encoder
    counts = {"zero_count": encoder.zero_count, "counts_per_m": encoder.counts_per_m}
    part = f"part-{number}"
    return EpisodeMetadata(
        id=f"018f0000-0000-7000-8000-00000000f0{number:02d}",
        start="2026-05-04T10:20:30.123456789Z",
        task=Task(name="tabletop-play", instruction="Pick it up, and put it down again."),
        regime="play",
        licence="CC0-1.0",
        calibration={"width_encoder": CalibrationItem(value=counts, method="known")},
        annotations=Annotations(object_id=part, part_id=part, trial=0),
        source=Source(type="simulated", tool="exumi-data", tool_version=__version__),
    )


def fields_of(stream: SimulatedStream, *, lossless: bool) -> dict[str, Any]:
    """Return what a stream's kind asks for."""
    if stream.kind == "pose":
        return {"frames": Frames(parent="world", child="gripper")}
    if stream.kind == "width":
        return {"raw": RawData(unit="count", transform="width_encoder")}
    height, width, _ = stream.render(0).shape
    images: Images = ArrayImages(encoding="array", height=height, width=width, channels=3)
    if not lossless:
        images = EncodedImages(
            encoding="encoded", media_type="image/jpeg", height=height, width=width, channels=3
        )
    side = stream.name.removeprefix("tactile_")
    sensor = (
        {"sensor": Sensor(model="simulated-gel", side=side)} if side in ("left", "right") else {}
    )
    return {"images": images, **sensor}


def write_stream(writer: EpisodeWriter, stream: SimulatedStream, *, lossless: bool) -> None:
    """Write the samples of a stream's first moments."""
    rows = slice(0, FRAMES if stream.data is None else 4 * FRAMES)
    clock = Clock(
        source="session",
        stamp_point="simulated",
        latency_ns=stream.latency_ns,
        raw_time="time_host",
        method="known",
    )
    rate = str(round(stream.rate_hz))
    fields = fields_of(stream, lossless=lossless)
    out = writer.add_stream(stream.name, kind=stream.kind, clock=clock, nominal_rate=rate, **fields)
    beside: dict[str, Any] = {
        "time_host": stream.time_ns[rows],
        "sequence": stream.sequence[rows].astype(np.uint64),
    }
    time = stream.capture_time_ns[rows]
    if stream.data is not None:
        raw = {} if stream.raw is None else {"raw": stream.raw[rows]}
        out.append(time, stream.data[rows], **raw, **beside)
        return
    frames = [stream.render(index) for index in range(FRAMES)]
    out.append(time, frames if lossless else [jpeg.encode(f, 90) for f in frames], **beside)
    if stream.reference is not None:
        out.set_reference(stream.reference, method="captured", contact_free=True)
        write_activity(writer, stream, frames)


def write_activity(
    writer: EpisodeWriter, stream: SimulatedStream, frames: list[np.ndarray]
) -> None:
    """Write the derived activity of a tactile stream."""
    meter = ActivityMeter(stream.reference)
    values = [meter.measure(np.ascontiguousarray(frame[..., 1])) for frame in frames]
    writer.add_derived(
        stream.name,
        "activity",
        np.array(values, np.float32),
        algorithm=ACTIVITY_METHOD,
        parameters={
            "threshold": meter.threshold,
            "size": meter.size,
            "active_above": ACTIVE_THRESHOLD,
        },
        inputs=[f"streams/{stream.name}/data", f"streams/{stream.name}/reference"],
    )


def write_session(path: Path, number: int, *, lossless: bool = False) -> None:
    """Write a simulated episode."""
    session = simulate_play(seed=number, duration_s=3.0, tactile_size=SIZE, rgb_size=SIZE)
    with EpisodeWriter(path, metadata(number, session), durable=False) as writer:
        for stream in session.streams.values():
            write_stream(writer, stream, lossless=lossless)


def packed(folder: Path) -> None:
    """Pack an episode in place of its folder."""
    pack(folder)
    remove(folder)


def remove(folder: Path) -> None:
    """Remove a folder that this program has just made."""
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()


def write_dataset(root: Path) -> None:
    """Write a dataset of a folder and a packed episode, with a split and a catalog."""
    create_dataset(root, DatasetMetadata(name="frozen", licence="CC0-1.0", authors=["A. Person"]))
    for number in (3, 4):
        episode = root / episode_path(f"018f0000-0000-7000-8000-00000000f0{number:02d}")
        write_session(episode, number)
        if number == 4:
            packed(episode)
    table, _ = build_catalog(root)
    write_catalog(root, table)
    split = make_split(open_dataset(root), level="part", ratio=(1, 1))
    (root / "splits").mkdir()
    write_json(root / "splits" / "default.json", dump(split))
    document = root / "dataset.json"
    named = parse_dataset(document.read_bytes(), document)
    named.splits = ["default"]
    write_json(document, dump(named))


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document."""
    path.write_text(json.dumps(document, indent=1) + "\n", "utf-8")


def write_described(path: Path, name: str) -> None:
    """Write an episode of the corpus with our writer."""
    adapter = SPEC / "conformance" / "adapters" / "exumi_writer.py"
    description = SPEC / "conformance" / VERSION / "writing" / name
    subprocess.run([sys.executable, str(adapter), str(description), str(path)], check=True)  # noqa: S603  # our own program


def add_case(name: str, store: str, about: str) -> Path:
    """Make the folder of a case; return where its store goes."""
    folder = HERE / "valid" / name
    folder.mkdir(parents=True)
    write_json(folder / "expected.json", {"about": about, "store": store, "findings": []})
    return folder / store.removesuffix(".zip")


def write_cases() -> None:
    """Write all cases."""
    for name, number, lossless in (("play__jpeg", 1, False), ("play__lossless", 2, True)):
        path = add_case(name, "store.zarr.zip", "The beginning of a simulated grasp.")
        write_session(path, number, lossless=lossless)
        packed(path)
    for name in FROM_CORPUS:
        path = add_case(name, "store.zarr.zip", "An episode of the corpus, by our writer.")
        write_described(path, name)
        packed(path)
    write_dataset(add_case("dataset__split", "dataset", "Two episodes, a split and a catalog."))


def write_dumps() -> None:
    """Write the canonical dump of each case."""
    for expected in HERE.glob("valid/*/expected.json"):
        store = expected.parent / json.loads(expected.read_bytes())["store"]
        command = [sys.executable, str(SPEC / "readers" / "dump.py"), str(store)]
        done = subprocess.run(command, check=True, capture_output=True)  # noqa: S603  # our own program
        (expected.parent / "dump.json").write_bytes(done.stdout)


def write_checksums() -> None:
    """List the checksum of each file."""
    files = sorted(path for path in HERE.rglob("*") if path.is_file())
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(HERE).as_posix()}\n"
        for path in files
    ]
    (HERE / "sha256.txt").write_text("".join(lines), "utf-8")


def main() -> int:
    """Run the program."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    if HERE.exists():
        sys.stderr.write(f"{HERE.relative_to(SPEC)} is there, and is never written again\n")
        return 1
    write_cases()
    write_dumps()
    write_checksums()
    return 0


if __name__ == "__main__":
    sys.exit(main())
