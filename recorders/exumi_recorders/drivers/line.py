"""Sensors that send a line of text a sample, over a serial port or UDP.

`LineDriver` does all but read the line: a new sensor is a function from a line to numbers, and a
`Port` that says what they are. The driver ``line`` needs no code: a rig file says which fields of
the line are recorded.
"""

import math
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, JsonValue, model_validator

from exumi_recorders.contract import (
    DeviceError,
    DriverType,
    Event,
    Health,
    Port,
    Rows,
    Sample,
)
from exumi_recorders.drivers.waiting import first_items

__all__ = ["DRIVER", "FieldsOptions", "LineDriver", "LineSource", "Reading"]

_MOST_BYTES = 4096
_LARGEST_DATAGRAM = 65535
_SILENT_S = 1.0
_REJECTED_SHARE = 0.01


class LineSource(BaseModel):
    """Where lines come from; options of a driver build on it."""

    model_config = ConfigDict(extra="forbid", strict=True)

    port: str | None = None
    """A serial port, such as ``/dev/serial/by-id/...``."""
    baud: int = Field(default=115200, ge=50)
    udp: int | None = Field(default=None, ge=1, le=65535)
    """Or a UDP port to listen at: a datagram is one or more whole lines."""
    address: str = "0.0.0.0"  # noqa: S104  # a sensor on the network has to reach it
    """At which of the machine's addresses to listen."""

    @model_validator(mode="after")
    def _one_source(self) -> "LineSource":
        if (self.port is None) == (self.udp is None):
            raise ValueError("say either `port` (serial) or `udp`")
        return self


@dataclass(frozen=True, slots=True)
class Reading:
    """What a line says.

    Attributes
    ----------
    values : sequence of float
        As many as a row of the port holds.
    sequence : int, optional
        The device's own counter.
    time_device_ns : int, optional
        The device's own clock, in the port's `time_device_unit`.
    """

    values: Sequence[float]
    sequence: int | None = None
    time_device_ns: int | None = None


class _Source(Protocol):
    def receive(self, timeout_s: float) -> bytes: ...

    def close(self) -> None: ...


class LineDriver:
    """A driver of a sensor that sends lines.

    Parameters
    ----------
    port : Port
        With `Rows` of ``data`` alone.
    source : LineSource
    parse : callable
        From a line without its end to a `Reading`, or None for a line that is no sample, such as a
        greeting. A `ValueError` or `IndexError` counts the line as rejected.
    """

    def __init__(
        self, port: Port, source: LineSource, parse: Callable[[bytes], Reading | None]
    ) -> None:
        if not isinstance(port.payload, Rows) or list(port.payload.arrays) != ["data"]:
            raise ValueError(f"port {port.name!r}: its payload must be rows of `data` alone")
        dtype, shape = port.payload.arrays["data"]
        self.ports = (port,)
        self._dtype, self._count = np.dtype(dtype), math.prod(shape)
        self._options, self._parse = source, parse
        self._source: _Source | None = None
        self._forget()

    def _forget(self) -> None:
        # A serial port is opened in the middle of a line: what comes first is no whole one.
        self._rest: bytes | None = None if self._options.udp is None else b""
        self._rejected = self._taken = 0
        self._last_s = time.monotonic()

    def open(self) -> None:
        """Open the serial port, or listen.

        Raises
        ------
        DeviceError
            It is not there, in use, or open already.
        MissingExtraError
            A serial port is asked for, and pyserial is not installed.
        """
        if self._source is not None:
            raise DeviceError("the sensor is open already", where=self._where())
        if self._options.port is not None:
            from exumi_recorders.drivers.serial_port import SerialPort

            self._source = SerialPort(self._options.port, self._options.baud)
        else:
            self._source = _Datagrams(self._options.address, self._options.udp or 0)
        self._forget()

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Return the samples of the lines that came.

        Raises
        ------
        DeviceLostError
            The device is gone.
        DeviceError
            It is not open.
        """
        source = self._source
        if source is None:
            raise DeviceError("the sensor is not open", where=self._where())

        def receive(left_s: float) -> list[Sample | Event]:
            chunk = source.receive(left_s)
            time_ns = time.monotonic_ns()
            samples = (self._sample(line, time_ns) for line in self._lines(chunk))
            return [sample for sample in samples if sample is not None]

        return first_items(receive, timeout_s)

    def health(self) -> Health:
        """Tell whether lines come that can be read."""
        problems = []
        if self._source is not None and time.monotonic() - self._last_s > _SILENT_S:
            problems.append(f"{self._where()} has sent nothing for a while.")
        if self._rejected > _REJECTED_SHARE * (self._taken + self._rejected):
            problems.append(f"{self._where()} sent {self._rejected} lines that cannot be read.")
        return Health(lost={"rejected": self._rejected}, problems=tuple(problems))

    def close(self) -> None:
        """Release it."""
        source, self._source = self._source, None
        if source is not None:
            source.close()

    def _where(self) -> str:
        return self._options.port or f"UDP port {self._options.udp}"

    def _lines(self, chunk: bytes) -> list[bytes]:
        if self._options.udp is not None:
            return chunk.splitlines()
        *lines, rest = ((self._rest or b"") + chunk).split(b"\n")
        if self._rest is None:
            if not lines:
                return []
            lines = lines[1:]
        if len(rest) > _MOST_BYTES:  # no line is so long
            self._rejected += 1
            self._rest = None
        else:
            self._rest = rest
        return [line.rstrip(b"\r") for line in lines]

    def _sample(self, line: bytes, time_ns: int) -> Sample | None:
        try:
            reading = self._parse(line)
            if reading is None:
                return None
            if len(reading.values) != self._count:
                raise ValueError(f"{len(reading.values)} values")
            with np.errstate(over="ignore"):  # it becomes infinite, and is refused below
                row = np.array(reading.values, self._dtype)
            if not np.isfinite(row).all():
                raise ValueError("no number")
        except (ValueError, IndexError, OverflowError):
            self._rejected += 1
            return None
        self._taken += 1
        self._last_s = time_ns / 1e9
        return Sample(
            port=self.ports[0].name,
            time_host_ns=time_ns,
            payload=row.tobytes(),
            time_device_ns=reading.time_device_ns,
            sequence=reading.sequence,
        )


class _Datagrams:
    """A UDP socket that is listened to."""

    def __init__(self, address: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((address, port))
        except OSError as error:
            self._socket.close()
            raise DeviceError(
                f"cannot listen at {address} ({error.strerror})", where=f"UDP port {port}"
            ) from None

    def receive(self, timeout_s: float) -> bytes:
        self._socket.settimeout(max(timeout_s, 0.0))
        with suppress(TimeoutError, BlockingIOError):
            return self._socket.recv(_LARGEST_DATAGRAM)  # one that is cut ends in half a number
        return b""

    def close(self) -> None:
        self._socket.close()


class FieldsOptions(LineSource):
    """A sensor that sends numbers with a separator, in a rig file."""

    kind: str = "wrench"
    columns: list[int] = Field(min_length=1, max_length=64)
    """Which fields of a line are recorded, from 0, in this order."""
    separator: str | None = Field(default=",", min_length=1)
    """Between fields; none is any white space."""
    scale: float = Field(default=1.0, allow_inf_nan=False)
    """What values are multiplied with, such as 0.001 for a sensor that sends millinewtons."""
    sequence_column: int | None = None
    """The field that counts samples."""
    modulus: int | None = Field(default=None, ge=2)
    """Where that count wraps."""
    rate_hz: int | None = Field(default=None, ge=1)
    metadata: Mapping[str, JsonValue] = {}
    """Other fields of the stream, such as ``components`` of a wrench."""


def _fields_parser(options: FieldsOptions) -> Callable[[bytes], Reading | None]:
    separator = None if options.separator is None else options.separator.encode()

    def parse(line: bytes) -> Reading | None:
        if not line.strip():
            return None
        words = line.split(separator)
        counted = options.sequence_column
        return Reading(
            [float(words[column]) * options.scale for column in options.columns],
            None if counted is None else int(words[counted]),
        )

    return parse


def _make(options: Any) -> LineDriver:
    scalar = options.kind == "width"
    port = Port(
        name="values",
        kind=options.kind,
        payload=Rows({"data": ("<f4", () if scalar else (len(options.columns),))}),
        stamp_point="user_rx",
        nominal_rate=None if options.rate_hz is None else str(options.rate_hz),
        modulus=options.modulus,
        metadata=dict(options.metadata),
    )
    return LineDriver(port, options, _fields_parser(options))


DRIVER = DriverType(
    "line", "Numbers as lines of text, by serial port or UDP.", FieldsOptions, _make
)
