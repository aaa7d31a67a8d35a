"""A device that sends numbered samples: what was recorded can be told from what it sent."""

import struct
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from exumi_data.model import EpisodeMetadata, Source, Task
from exumi_data.store import jpeg
from exumi_recorders.contract import (
    DeviceLostError,
    Driver,
    Event,
    Files,
    Health,
    Port,
    Rows,
    Sample,
)
from exumi_recorders.recording.device import RecordedDevice

SIZE = (48, 64, 3)
POSE = Port(
    name="pose",
    kind="pose",
    payload=Rows({"data": ("<f8", (7,))}),
    stamp_point="kernel_rx",
    nominal_rate="90",
    metadata={"frames": {"parent": "world", "child": "tcp"}},
)
COUNTER = Port(
    name="counter",
    kind="taxels",
    payload=Rows({"data": ("<i2", (1, 2))}),
    stamp_point="user_rx",
    nominal_rate="500",
    metadata={"grid": (1, 2), "unit": "1"},
)
CAMERA = Port(
    name="camera",
    kind="rgb",
    payload=Files(*SIZE),
    stamp_point="buffer_soe",
    nominal_rate="30",
    droppable=True,
)


@lru_cache(maxsize=1)
def a_picture() -> bytes:
    rng = np.random.default_rng(1)
    return jpeg.encode(rng.integers(0, 255, SIZE, np.uint8), 80)


def picture(number: int) -> bytes:
    """A JPEG whose comment says which one it is."""
    file = a_picture()
    comment = struct.pack(">4sQ", b"toy ", number)
    return file[:2] + b"\xff\xfe" + struct.pack(">H", 2 + len(comment)) + comment + file[2:]


def number_of(file: bytes) -> int:
    return int(struct.unpack(">Q", file[10:18])[0])


def pose(number: int) -> bytes:
    return struct.pack("<7d", number, number * 0.5, 0, 0, 0, 0, 1)


def counter(number: int) -> bytes:
    return struct.pack("<2h", number & 0x7FFF, number >> 15)


PAYLOADS = {"pose": pose, "counter": counter, "camera": picture}
PORTS = {"pose": POSE, "counter": COUNTER, "camera": CAMERA}


@dataclass
class Toy:
    """A driver that sends numbered samples of some ports, each at its own rate."""

    rates: Mapping[str, float] = field(default_factory=lambda: {"pose": 90.0, "camera": 30.0})
    with_sequence: bool = True
    ports: tuple[Port, ...] = ()
    lose_at_s: float | None = None
    back_after: int = 1
    freeze_at_s: float | None = None
    says: Health = field(default_factory=Health)
    events: list[Event] = field(default_factory=list)
    sent: dict[str, int] = field(default_factory=dict)
    opened: int = 0

    def __post_init__(self) -> None:
        self.ports = self.ports or tuple(PORTS[name] for name in self.rates)

    def open(self) -> None:
        self.opened += 1
        if 1 < self.opened <= self.back_after:
            msg = "it is not there"
            raise DeviceLostError(msg)
        self._start = time.monotonic_ns()
        self._next = dict.fromkeys(self.rates, 0)

    def read(self, timeout_s: float) -> list[Sample | Event]:
        elapsed = (time.monotonic_ns() - self._start) / 1e9
        if self.lose_at_s is not None and self.opened == 1 and elapsed > self.lose_at_s:
            msg = "the plug was pulled"
            raise DeviceLostError(msg)
        found: list[Sample | Event] = list(self.events)
        self.events.clear()
        for name, rate in self.rates.items():
            while self._next[name] / rate <= elapsed:
                found.append(self._sample(name, self._next[name], rate))
                self._next[name] += 1
        if not found:
            time.sleep(min(timeout_s, 0.5 / max(self.rates.values())))
        return found

    def _sample(self, name: str, own: int, rate: float) -> Sample:
        number = self.sent.get(name, 0)
        self.sent[name] = number + 1
        at = self._start + round(own / rate * 1e9)
        shown = number
        if self.freeze_at_s is not None:
            shown = min(number, int(self.freeze_at_s * rate))
        sequence = own if self.with_sequence else None
        return Sample(name, at, PAYLOADS[name](shown), sequence=sequence)

    def health(self) -> Health:
        return self.says

    def close(self) -> None:
        pass


def device(toy: Driver, name: str = "toy", ports: Iterable[str] | None = None) -> RecordedDevice:
    chosen = [port.name for port in toy.ports] if ports is None else ports
    return RecordedDevice(name, toy, {port: port for port in chosen})


def port(base: Port, **changes: Any) -> Port:
    return replace(base, **changes)


def episode(number: int = 1, **fields: Any) -> EpisodeMetadata:
    values: dict[str, Any] = {
        "id": f"0190a1b2-4c5d-7e8f-9a0b-{number:012d}",
        "task": Task(name="toy"),
        "regime": "play",
        "licence": "CC0-1.0",
        "source": Source(type="recorded", tool="exumi", tool_version="0"),
    }
    return EpisodeMetadata(**{**values, **fields})
