"""Recording under load: two tactile cameras, a wrist camera, poses, an encoder and taxels.

Another process sends numbered samples over sockets, at the rates and sizes of a full rig; this one
records them. Reported are the processor time and memory of the recording process, what was dropped,
whether every number is in the journal, and how old poses were when they were on the disk::

    python benchmarks/recording.py --work FOLDER --seconds 600 --json results/recording.json
"""

import argparse
import json
import os
import resource
import select
import shutil
import socket
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

from exumi_data.dataset import create_dataset
from exumi_data.model import DatasetMetadata, EpisodeMetadata, Source, Task
from exumi_data.store import jpeg
from exumi_recorders.contract import (
    DeviceLostError,
    Event,
    Files,
    Health,
    Port,
    Rows,
    Sample,
)
from exumi_recorders.finalise.headers import read_header
from exumi_recorders.finalise.rows import payload_bytes_of
from exumi_recorders.journal.reading import LogReader
from exumi_recorders.journal.record import HEADER_BYTES, salt_of, unpack_header
from exumi_recorders.recording.device import RecordedDevice
from exumi_recorders.recording.recorder import Recorder

MESSAGE = struct.Struct("<qqI")  # stamp, number, length
EPISODE = "0190a1b2-4c5d-7e8f-9a0b-00000000be7c"


@dataclass(frozen=True)
class Load:
    """What one device sends."""

    rate: int
    size: int
    image: tuple[int, int] | None = None
    kind: str = "taxels"
    array: tuple[str, tuple[int, ...]] = ("<i2", (11, 6))
    metadata: dict[str, Any] = field(default_factory=dict)


LOADS = {
    "tactile_left": Load(30, 80_000, (480, 640), "tactile"),
    "tactile_right": Load(30, 80_000, (480, 640), "tactile"),
    "wrist": Load(60, 200_000, (1080, 1920), "rgb"),
    "pose": Load(
        90, 56, None, "pose", ("<f8", (7,)), {"frames": {"parent": "world", "child": "tcp"}}
    ),
    "encoder": Load(500, 4, None, "width", ("<f4", ())),
    "taxels": Load(1000, 132, metadata={"grid": [11, 6], "unit": "adc"}),
}


class SocketDevice:
    """A driver that reads one of the generator's sockets."""

    def __init__(self, name: str, load: Load, path: Path) -> None:
        self._path = path
        self._name = name
        self._socket: socket.socket | None = None
        self._rest = b""
        self._is_image = load.image is not None
        payload: Files | Rows = Rows({"data": load.array})
        if load.image is not None:
            payload = Files(*load.image, 3)
        self.ports = (
            Port(
                name=name,
                kind=load.kind,
                payload=payload,
                stamp_point="kernel_rx",
                nominal_rate=str(load.rate),
                droppable=load.image is not None,
                metadata=load.metadata,
            ),
        )

    def open(self) -> None:
        """Connect."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.connect(str(self._path))

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Return what has come."""
        if self._socket is None or not select.select([self._socket], [], [], timeout_s)[0]:
            return []
        return self._image(self._socket) if self._is_image else self._rows(self._socket)

    def _image(self, connection: socket.socket) -> list[Sample | Event]:
        header = connection.recv(MESSAGE.size, socket.MSG_WAITALL)
        if len(header) < MESSAGE.size:
            raise DeviceLostError("the generator has ended")
        stamp, number, length = MESSAGE.unpack(header)
        file = connection.recv(length, socket.MSG_WAITALL)
        return [Sample(self._name, stamp, file, sequence=number)]

    def _rows(self, connection: socket.socket) -> list[Sample | Event]:
        data = self._rest + connection.recv(1 << 16)
        found: list[Sample | Event] = []
        at = 0
        while len(data) - at >= MESSAGE.size:
            stamp, number, length = MESSAGE.unpack_from(data, at)
            if len(data) - at < MESSAGE.size + length:
                break
            start = at + MESSAGE.size
            found.append(Sample(self._name, stamp, data[start : start + length], sequence=number))
            at = start + length
        self._rest = data[at:]
        return found

    def health(self) -> Health:
        """Return that all is well."""
        return Health()

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()


def picture(image: tuple[int, int], size: int) -> bytes:
    """Return a real JPEG of a size in pixels, padded to a size in bytes."""
    rows, columns = np.mgrid[: image[0], : image[1]]
    frame = np.stack([rows % 256, columns % 256, (rows + columns) % 256], axis=2).astype(np.uint8)
    file = jpeg.encode(frame, 60)
    if len(file) > size:
        raise SystemExit(f"the picture has {len(file)} bytes")
    while len(file) < size:
        room = min(size - len(file), 60_000)
        comment = b"\xff\xfe" + struct.pack(">H", max(2, room - 2)) + bytes(max(0, room - 4))
        file = file[:2] + comment + file[2:]
    return file


def generate(folder: Path) -> None:
    """Send samples until nobody listens any more."""
    listening = {}
    for name in LOADS:
        server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        server.bind(str(folder / name))
        server.listen(1)
        listening[name] = server
    print("ready", flush=True)
    streams = []
    start = time.monotonic_ns()
    for name, load in LOADS.items():
        connection, _ = listening[name].accept()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
        payload = bytes(load.size) if load.image is None else picture(load.image, load.size)
        if load.kind == "pose":
            payload = struct.pack("<7d", 0, 0, 0, 0, 0, 0, 1)
        streams.append((connection, load, payload))
    numbers = [0] * len(streams)
    try:
        while True:
            due = [
                start + number * 1_000_000_000 // load.rate
                for number, (_, load, _) in zip(numbers, streams, strict=True)
            ]
            first = min(due)
            wait = first - time.monotonic_ns()
            if wait > 0:
                time.sleep(wait / 1e9)
            for index, (connection, _, payload) in enumerate(streams):
                if due[index] == first:
                    body = payload
                    if len(payload) == 56:
                        body = struct.pack("<d", numbers[index] * 1e-3) + payload[8:]
                    stamp = time.monotonic_ns()
                    connection.sendall(MESSAGE.pack(stamp, numbers[index], len(body)) + body)
                    numbers[index] += 1
    except (BrokenPipeError, ConnectionResetError):
        return


def watch(log: Path, seconds: float) -> None:
    """Follow a log of records of one length; print how old each was when it was there."""
    ages: list[float] = []
    size = HEADER_BYTES + LOADS["pose"].size
    end = time.monotonic() + seconds
    while not log.exists() and time.monotonic() < end:
        time.sleep(0.001)
    with log.open("rb", buffering=0) as file:
        rest, seen = b"", False
        while time.monotonic() < end:
            rest += file.read(1 << 16)
            now = time.monotonic_ns()
            while len(rest) >= size:
                header = unpack_header(rest)
                # What was there before the first look is older than it was when it came.
                if header is not None and seen:
                    ages.append((now - header.time_host_ns) / 1e6)
                rest = rest[size:]
            seen = True
            time.sleep(0.0002)
    print(json.dumps(ages))


def account(journal: Path, began_ns: int, ended_ns: int) -> dict[str, Any]:
    """Say whether every sample that was sent while recording is in the journal."""
    header, _ = read_header(journal)
    found = {}
    for name, stream in header.streams.items():
        log = LogReader(journal / name, salt_of(EPISODE, name), payload_bytes_of(stream))
        count, missing, last, first, until = 0, 0, None, 0, 0
        for block in log:
            numbers = block.sequence
            missing += int((np.diff(numbers) - 1).sum())
            if last is not None:
                missing += int(numbers[0]) - last - 1
            else:
                first = int(block.time_host[0])
            last, until = int(numbers[-1]), int(block.time_host[-1])
            count += len(block)
        period_ms = 1e3 / LOADS[name].rate
        found[name] = {
            "samples": count,
            "missing": missing,
            "damages": len(log.damages),
            "first_after_ms": round((first - began_ns) / 1e6, 2),
            "last_before_ms": round((ended_ns - until) / 1e6, 2),
            "period_ms": round(period_ms, 2),
        }
    return found


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", action="store_true", help="Leave the journal, for finalise.py.")
    parser.add_argument("--no-watch", action="store_true", help="Do not measure ages.")
    parser.add_argument("--generate", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--watch", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.generate is not None:
        generate(arguments.generate)
        return
    if arguments.watch is not None:
        watch(arguments.watch, arguments.seconds)
        return
    root = arguments.work / "recording"
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    report("recording", run(root, arguments), arguments.json)
    if not arguments.keep:
        shutil.rmtree(root)


def run(root: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Record, and measure."""
    machine = describe_machine(("exumi-data", "numpy"))
    dataset = root / "dataset"
    create_dataset(dataset, DatasetMetadata(name="load", licence="CC0-1.0"))
    script = [sys.executable, __file__, "--work", str(root)]
    generator = subprocess.Popen(
        [*script, "--generate", str(root)], stdout=subprocess.PIPE, text=True
    )
    if generator.stdout is not None:
        generator.stdout.readline()  # it listens
    devices = [
        RecordedDevice(name, SocketDevice(name, load, root / name), {name: name})
        for name, load in LOADS.items()
    ]
    metadata = EpisodeMetadata(
        id=EPISODE,
        task=Task(name="load"),
        regime="play",
        licence="CC0-1.0",
        source=Source(type="recorded", tool="benchmarks/recording.py", tool_version="1"),
    )
    watcher = None
    recorder = Recorder(devices)
    recorder.open()
    time.sleep(1.0)
    began_ns = time.monotonic_ns()
    journal = recorder.start(dataset, metadata)
    if not arguments.no_watch:
        log = journal / "pose" / "000000.log"
        seconds = str(arguments.seconds)
        watcher = subprocess.Popen(
            [*script, "--watch", str(log), "--seconds", seconds], stdout=subprocess.PIPE, text=True
        )
    before, wall = os.times(), time.monotonic()
    peaks = []
    pressures = []
    while time.monotonic() - wall < arguments.seconds:
        time.sleep(0.5)  # as often as an operator's display is drawn
        status = recorder.status()
        pressures.append(status.pressure)
        peaks.append(_memory_mib())
    after, wall = os.times(), time.monotonic() - wall
    ended_ns = time.monotonic_ns()
    recorded = recorder.stop()
    recorder.close()
    generator.terminate()
    generator.wait()
    ages = json.loads(watcher.communicate()[0]) if watcher is not None else []
    used = (after.user - before.user) + (after.system - before.system)
    streams = account(journal, began_ns, ended_ns)
    return {
        "machine": machine,
        "seconds": round(wall, 1),
        "written_mb": round(sum(path.stat().st_size for path in journal.rglob("*.log")) / 1e6),
        "share_of_one_core": round(used / wall, 3),
        "user_s": round(after.user - before.user, 2),
        "system_s": round(after.system - before.system, 2),
        "memory_mib": {"most": max(peaks), "end": peaks[-1]},
        "peak_rss_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "highest_pressure": round(max(pressures), 3),
        "dropped": sum(recorded.dropped.values()),
        "missing": sum(each["missing"] for each in streams.values()),
        "truncated": recorded.truncated,
        "pose_age_ms": _percentiles(ages),
        "streams": streams,
    }


def _memory_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20), 1)


def _percentiles(values: list[float]) -> dict[str, float]:
    if not values:
        return {}
    marks = np.percentile(values, [50, 90, 99, 100])
    names = ("median", "p90", "p99", "most")
    return {name: round(float(mark), 3) for name, mark in zip(names, marks, strict=True)}


if __name__ == "__main__":
    main()
