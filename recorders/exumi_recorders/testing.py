"""The contract of drivers, for other packages to run on their own.

It needs no pytest, and no knowledge of the device: whoever runs it brings a device that delivers,
a real one or a simulated one that speaks the real protocol.
"""

import json
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from exumi_data.errors import DamagedDataError, ExumiError
from exumi_data.model.base import STREAM_NAME, Rational
from exumi_data.model.clock import Clock
from exumi_data.model.streams import Stream
from exumi_data.standard import registry
from exumi_data.store import jpeg
from exumi_recorders.contract import (
    DeviceError,
    Driver,
    Event,
    Files,
    Health,
    Payload,
    Port,
    Rows,
    Sample,
)

__all__ = ["check_driver"]

_TIMEOUT_S = 0.05
# How much later than asked a call may come back, and how long a look at the health may take, on a
# machine that is busy with other things.
_LATE_S = 0.3
_HEALTH_S = 0.1
_CLOSE_S = 3.0
_HEALTH_EVERY_S = 0.05
# Beyond its seconds: what opening three times and closing may take before it is given up.
_PATIENCE_S = 15.0
# Samples of which a sequence that never changes is no chance.
_FEW = 3
# How long a device that was opened again gets for its first sample, at least.
_AGAIN_S = 1.0
_UINT32 = 1 << 32
_INT64 = 1 << 63


def check_driver(make: Callable[[], Driver], *, seconds: float = 1.0) -> None:
    """Check that a driver keeps the contract, with a device that delivers.

    The device is opened, read for some seconds while another thread asks for its health, opened
    again without closing it, closed twice, and opened, read and closed once more. At the end, its
    streams are stored for trial.

    Parameters
    ----------
    make : callable
        Returns a new driver that is not open.
    seconds : float, optional
        How long to read; the device must deliver at least one sample in this time.

    Raises
    ------
    AssertionError
        With all that is wrong, a line each.
    """
    trial = _Trial(make, seconds)
    # A daemon, so that a driver that never comes back does not keep the program from ending.
    worker = threading.Thread(target=trial.run, name="check_driver", daemon=True)
    worker.start()
    deadline = time.monotonic() + seconds + _PATIENCE_S
    while worker.is_alive() and time.monotonic() < deadline:
        worker.join(_HEALTH_EVERY_S)
        trial.look_at_health()
    found = trial.found
    if worker.is_alive():
        found.note(f"{trial.doing} has not come back")
    if lines := found.lines():
        raise AssertionError("\n".join(lines))


@dataclass
class _Found:
    """What is wrong, each once, with how often it was seen."""

    counts: Counter[str] = field(default_factory=Counter)

    def note(self, problem: str) -> None:
        self.counts[problem] += 1

    def lines(self) -> list[str]:
        return [
            text if count == 1 else f"{text} ({count} times)"
            for text, count in list(self.counts.items())
        ]


@dataclass(slots=True)
class _Seen:
    """What was seen of a port since the device was opened."""

    first_ns: tuple[int, int]
    last_ns: tuple[int, int]
    sequences: set[int | None]
    device_times: set[bool]
    count: int = 0

    @classmethod
    def of(cls, sample: Sample, now_ns: int) -> "_Seen":
        at = now_ns, sample.time_host_ns
        return cls(at, at, set(), set())

    def take(self, sample: Sample, now_ns: int) -> None:
        self.last_ns = now_ns, sample.time_host_ns
        self.count += 1
        if sample.sequence is None or len(self.sequences) < _FEW:  # so many are enough to know
            self.sequences.add(sample.sequence)
        self.device_times.add(sample.time_device_ns is None)

    def mistakes(self, seconds: float) -> list[str]:
        pairs = zip(self.first_ns, self.last_ns, strict=True)
        came, stamped = (last - first for first, last in pairs)
        found = []
        if came > 0.5 * seconds * 1e9 and stamped < 0.5 * came:
            found.append("time_host_ns does not go on as time does")
        if None in self.sequences and len(self.sequences) > 1:
            found.append("some have a sequence, and some have none")
        if self.count >= _FEW and len(self.sequences) == 1 and None not in self.sequences:
            found.append("its sequence is always the same")
        if len(self.device_times) > 1:
            found.append("some have a device time, and some have none")
        return found


@dataclass
class _Trial:
    """One driver on its way through the contract."""

    make: Callable[[], Driver]
    seconds: float
    found: _Found = field(default_factory=_Found)
    doing: str = "make()"
    asked: Driver | None = None
    last_lost: dict[int, Mapping[str, int]] = field(default_factory=dict)
    opening: int | None = 0
    opened_ns: int = 0
    seen: dict[str, _Seen] = field(default_factory=dict)
    samples: int = 0

    def run(self) -> None:
        """Go through it all; what the driver raises is a finding like others."""
        try:
            driver = self.make()
            self._step(driver.close, "close() of a driver that was never opened")
            if not self._open(driver, "open()"):
                return
            ports = driver.ports
            self.asked = driver
            self._check_ports(ports)
            self._read(driver, ports, self.seconds)
            if not self.samples:
                self.found.note(f"no sample came in {self.seconds:g} s")
            for name, seen in self.seen.items():
                for problem in seen.mistakes(self.seconds):
                    self.found.note(f"samples of {name!r}: {problem}")
            self._open_twice(driver, ports)
            if driver.ports != ports:
                self.found.note("ports changed while it was open")
            self.asked = None
            self._step(driver.close, "close()")
            self._step(driver.close, "close() for a second time")
            self._reopen(driver, ports)
            self.doing = "storing its streams"
            self._store(ports)
        except Exception as error:  # noqa: BLE001  # a driver may raise anything, and all is told
            self.found.note(f"{self.doing} raised {_said(error)}")

    def look_at_health(self) -> None:
        """Ask for the health from a thread that is not the driver's."""
        driver = self.asked
        if driver is None:
            return
        began, opening = time.monotonic(), self.opening
        try:
            health: Any = driver.health()  # whatever it may be
        except Exception as error:  # noqa: BLE001  # same
            self.found.note(f"health() raised {_said(error)}")
            return
        if time.monotonic() - began > _HEALTH_S:
            self.found.note(f"health() took more than {_HEALTH_S:g} s")
        for problem in _mistakes_of_health(health):
            self.found.note(f"health(): {problem}")
        # Counts begin anew with an opening: those of one are not compared with those of another.
        if isinstance(health, Health) and opening is not None and opening == self.opening:
            for cause, count in self.last_lost.get(opening, {}).items():
                if health.lost.get(cause, 0) < count and cause != "sequence":
                    self.found.note(f"health(): lost[{cause!r}] went down while it was open")
            self.last_lost[opening] = dict(health.lost)

    def _step(self, call: Callable[[], None], name: str) -> None:
        self.doing, began = name, time.monotonic()
        try:
            call()
        except Exception as error:  # noqa: BLE001  # same
            self.found.note(f"{name} raised {_said(error)}")
        if time.monotonic() - began > _CLOSE_S:
            self.found.note(f"{name} took more than {_CLOSE_S:g} s")

    def _open(self, driver: Driver, name: str) -> bool:
        self.doing, self.opened_ns = name, time.monotonic_ns()
        self.seen.clear()
        try:
            driver.open()
        except Exception as error:  # noqa: BLE001  # same
            self.found.note(f"{name} raised {_said(error)}")
            return False
        return True

    def _check_ports(self, ports: Any) -> None:
        if not isinstance(ports, tuple) or not ports:
            self.found.note(f"ports is {ports!r}, not a tuple with at least one port")
        for port in ports:
            for problem in _mistakes_of_port(port):
                self.found.note(f"port {port.name!r}: {problem}")
        for name, count in Counter(port.name for port in ports).items():
            if count > 1:
                self.found.note(f"port {name!r}: {count} ports have this name")

    def _read(self, driver: Driver, ports: tuple[Port, ...], seconds: float) -> None:
        by_name = {port.name: port for port in ports}
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._read_once(driver, by_name, _TIMEOUT_S)
        self._read_once(driver, by_name, 0.0)

    def _read_once(self, driver: Driver, ports: Mapping[str, Port], timeout_s: float) -> None:
        self.doing = f"read({timeout_s:g})"
        began = time.monotonic()
        items: Any = driver.read(timeout_s)  # whatever it may be
        took = time.monotonic() - began
        now_ns = time.monotonic_ns()
        if took > timeout_s + _LATE_S:
            self.found.note(f"{self.doing} took more than {_LATE_S:g} s longer")
        if not isinstance(items, list):
            self.found.note(f"{self.doing} returned a {type(items).__name__}, not a list")
            return
        if not items and took < timeout_s / 2:
            self.found.note(f"{self.doing} came back with nothing long before its time was over")
        for item in items:
            self._check_item(item, ports, now_ns)

    def _check_item(self, item: object, ports: Mapping[str, Port], now_ns: int) -> None:
        if isinstance(item, Event):
            problems = _mistakes_of_event(item) + self._mistakes_of_time(item.time_host_ns, now_ns)
            for problem in problems:
                self.found.note(f"event {item.name!r}: {problem}")
        elif not isinstance(item, Sample):
            self.found.note(f"read() returned a {type(item).__name__} among the samples")
        elif item.port not in ports:
            self.found.note(f"a sample is of the port {item.port!r}, which is not among its ports")
        else:
            self.samples += 1
            problems = _mistakes_of_sample(item, ports[item.port])
            problems += self._mistakes_of_time(item.time_host_ns, now_ns)
            seen = self.seen.setdefault(item.port, _Seen.of(item, now_ns))
            if item.time_host_ns < seen.last_ns[1]:
                problems.append("time_host_ns goes back")
            seen.take(item, now_ns)
            for problem in problems:
                self.found.note(f"sample of {item.port!r}: {problem}")

    def _mistakes_of_time(self, time_ns: int, now_ns: int) -> list[str]:
        if not _is_whole(time_ns):
            return [f"time_host_ns is a {type(time_ns).__name__}, not an int"]
        if time_ns < self.opened_ns:
            return ["time_host_ns lies before open(), or is not CLOCK_MONOTONIC"]
        if time_ns > now_ns:
            return ["time_host_ns lies in the future, or is not CLOCK_MONOTONIC"]
        return []

    def _open_twice(self, driver: Driver, ports: tuple[Port, ...]) -> None:
        """Open it once more: refused, or without harm."""
        self.doing, self.opening = "open() of an open driver", None
        try:
            driver.open()
        except DeviceError:
            pass
        except Exception as error:  # noqa: BLE001  # same
            self.found.note(f"{self.doing} raised {_said(error)}, not a DeviceError")
        self.opening = 1
        before = self.samples
        self._read_until_sample(driver, ports)
        if before and self.samples == before:
            self.found.note("no sample comes any more after open() of an open driver")

    def _reopen(self, driver: Driver, ports: tuple[Port, ...]) -> None:
        before = self.samples
        if self._open(driver, "open() after close()"):
            if driver.ports != ports:
                self.found.note("ports are others after close() and open()")
            self._read_until_sample(driver, driver.ports)
            if before and self.samples == before:
                self.found.note("no sample came after close() and open()")
            self._step(driver.close, "close() after it was opened again")

    def _store(self, ports: tuple[Port, ...]) -> None:
        """Store a stream of each port for trial, as a recorder does before it records."""
        from exumi_recorders.finalise.rehearsal import rehearse
        from exumi_recorders.journal.header import StreamHeader, port_document

        for port in ports:
            if _mistakes_of_port(port):
                continue  # told already, in other words
            try:
                rehearse({port.name: StreamHeader(device="the driver", port=port_document(port))})
            except (ExumiError, ValidationError) as error:
                what = error.what if isinstance(error, ExumiError) else str(error)
                self.found.note(f"port {port.name!r}: {what}")

    def _read_until_sample(self, driver: Driver, ports: tuple[Port, ...]) -> None:
        by_name = {port.name: port for port in ports}
        before, until = self.samples, time.monotonic() + max(self.seconds, _AGAIN_S)
        while self.samples == before and time.monotonic() < until:
            self._read_once(driver, by_name, _TIMEOUT_S)


def _mistakes_of_port(port: Port) -> list[str]:
    found = []
    if not re.fullmatch(STREAM_NAME, port.name):
        found.append(f"its name does not match {STREAM_NAME}")
    if port.droppable and isinstance(port.payload, Rows):
        found.append("it is droppable: only images and sound may be dropped")
    if port.nominal_rate is not None and not _fits(Rational, port.nominal_rate):
        found.append(f"nominal_rate {port.nominal_rate!r} is not a rational such as 60000/1001")
    if port.modulus is not None and port.modulus < 2:
        found.append(f"modulus {port.modulus} is less than 2")
    unit = port.time_device_unit
    known = registry.units().get(unit) if unit is not None else None
    if unit is not None and (known is None or known.ns is None):
        found.append(f"time_device_unit {unit!r} is no unit of time of the registry")
    if port.stamp_point not in registry.stamp_points() or port.stamp_point == "nominal_rate":
        found.append(f"stamp_point {port.stamp_point!r} is none at which samples are stamped")
    if port.kind not in registry.kinds() and ":" not in port.kind:
        found.append(f"kind {port.kind!r} is not of the registry, nor named vendor:name")
    if isinstance(port.payload, Rows):
        found += _mistakes_of_rows(port, port.payload)
    found += _mistakes_of_valid(port)
    return found


def _mistakes_of_rows(port: Port, rows: Rows) -> list[str]:
    names = tuple(rows.arrays)
    wanted = (("raw",),) if port.transform else (("data",), ("data", "raw"), ("raw", "data"))
    if names not in wanted:
        meant = "raw alone" if port.transform else "data, and raw if there is one"
        return [f"its rows hold {', '.join(names) or 'nothing'}, not {meant}"]
    found = []
    kind = registry.kinds().get(port.kind)
    for name, (dtype, _) in rows.arrays.items():
        try:
            numbers = np.dtype(dtype)
        except TypeError:
            found.append(f"{name} has an unknown data type {dtype!r}")
            continue
        if dtype[:1] not in "<|":
            found.append(f"{name} is {dtype!r}: say the order of its bytes, little-endian")
        spec = kind.arrays.get(name) if kind else None
        if spec is not None and numbers.name not in spec.dtype:
            found.append(f"{name} is {numbers.name}, not {' or '.join(spec.dtype)}")
    if kind is not None and not found:
        found += _mistakes_of_metadata(port, names)
    return found


def _mistakes_of_metadata(port: Port, arrays: tuple[str, ...]) -> list[str]:
    """Say what keeps the stream's metadata from being what the standard asks for."""
    document = {
        "kind": port.kind,
        "clock": Clock(source="hub_monotonic", stamp_point="user_rx"),
        "arrays": ["time", *dict.fromkeys(("data", *arrays))],
        "nominal_rate": port.nominal_rate,
        "sensor": port.sensor,
        **port.metadata,
    }
    try:
        TypeAdapter[Any](Stream).validate_python(document)
    except ValidationError as error:
        return [
            f"its metadata: {'.'.join(map(str, one['loc'])) or port.kind}: {one['msg']}"
            for one in error.errors()
        ]
    return []


def _mistakes_of_valid(port: Port) -> list[str]:
    grid = port.metadata.get("grid")
    if port.valid is None or grid is None:
        return []
    shape = [len(port.valid), *{len(row) for row in port.valid}]
    return [] if shape == list(grid) else [f"valid is of {shape} cells, the grid of {list(grid)}"]


def _mistakes_of_sample(sample: Sample, port: Port) -> list[str]:
    found = []
    if type(sample.payload) is not bytes:
        found.append(f"its payload is a {type(sample.payload).__name__}, not bytes")
    else:
        found += _mistakes_of_payload(sample.payload, port.payload)
    if not _is_whole(sample.flags) or not 0 <= sample.flags < _UINT32:
        found.append(f"flags {sample.flags!r} is no 32-bit number")
    elif unknown := sample.flags & ~sum(1 << flag.bit for flag in registry.flags().values()):
        found.append(f"flags has bits {unknown:#x} that the registry does not know")
    if sample.sequence is not None:
        most = port.modulus or _INT64
        if not _is_whole(sample.sequence) or not 0 <= sample.sequence < most:
            found.append(f"sequence does not lie in [0, {most})")
    if sample.time_device_ns is not None:
        if port.time_device_unit is None:
            found.append("it has a device time, but its port no time_device_unit")
        if not _is_whole(sample.time_device_ns) or not -_INT64 <= sample.time_device_ns < _INT64:
            found.append("time_device_ns is no 64-bit number")
    return found


def _mistakes_of_payload(data: bytes, layout: Payload) -> list[str]:
    if isinstance(layout, Rows):
        size = _row_bytes(layout)
        if size is not None and len(data) != size:
            return [f"its payload has {len(data)} bytes, a row has {size}"]
    elif isinstance(layout, Files):
        try:
            found = jpeg.size_of(data) if jpeg.is_jpeg(data) else None
        except DamagedDataError:
            found = None
        if found is None:
            return ["its payload is no whole JPEG file"]
        if found != (layout.height, layout.width, layout.channels):
            said = f"{layout.width}x{layout.height} with {layout.channels} channels"
            return [f"its image is {found[1]}x{found[0]} with {found[2]} channels, not {said}"]
    elif not data or len(data) % (2 * layout.channels):
        return [f"its payload of {len(data)} bytes is no block of {layout.channels} channels"]
    return []


def _row_bytes(rows: Rows) -> int | None:
    """Return the bytes of a row; None where the layout is wrong, which is told of the port."""
    try:
        return sum(
            np.dtype(dtype).itemsize * int(np.prod(shape, dtype=np.int64))
            for dtype, shape in rows.arrays.values()
        )
    except TypeError:
        return None


def _mistakes_of_event(event: Any) -> list[str]:
    found = []
    if not isinstance(event.name, str) or not re.fullmatch(STREAM_NAME, event.name):
        found.append(f"its name does not match {STREAM_NAME}")
    if not _is_json(dict(event.detail)):
        found.append("its detail is not JSON")
    return found


def _mistakes_of_health(health: Any) -> list[str]:
    if not isinstance(health, Health):
        return [f"it is a {type(health).__name__}"]
    found = [
        f"lost[{cause!r}] is {count!r}, not a count"
        for cause, count in health.lost.items()
        if not _is_whole(count) or count < 0
    ]
    readings: Mapping[str, Any] = health.readings
    problems: Any = health.problems
    found += [
        f"readings[{name!r}] is a {type(value).__name__}"
        for name, value in readings.items()
        if not isinstance(value, float | int | str | bool) or not _is_json(value)
    ]
    if not isinstance(problems, tuple) or not all(
        isinstance(text, str) and text for text in problems
    ):
        found.append(f"problems is {problems!r}, not a tuple of sentences")
    sigma = health.stamp_sigma_ns
    if sigma is not None and not (np.isfinite(sigma) and sigma >= 0):
        found.append(f"stamp_sigma_ns is {sigma!r}")
    return found


def _is_whole(value: object) -> bool:
    # Not a bool, and not numpy's integers, which do not go into JSON or struct.
    return type(value) is int


def _is_json(value: object) -> bool:
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError):
        return False
    return True


def _fits(annotation: Any, value: object) -> bool:
    try:
        TypeAdapter[Any](annotation).validate_python(value, strict=True)
    except ValidationError:
        return False
    return True


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
