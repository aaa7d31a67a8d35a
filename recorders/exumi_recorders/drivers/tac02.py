"""TACNIQ's TAC-02: 64 taxels on a grid of 11 × 6, up to about a thousand frames a second.

The device sends no time, so a sample's host time is when this program received its last byte. USB
and the kernel hand over what has gathered, so frames of one hand-over have the same host time: that
is what is known, and nothing is spread between them.
"""

import time
from typing import Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field

from exumi_data.model.streams import Sensor
from exumi_recorders.contract import DeviceError, DriverType, Event, Health, Port, Rows, Sample
from exumi_recorders.drivers.tac02_frames import (
    GRID,
    OFFSET,
    VALID,
    FrameCutter,
    decode,
)

__all__ = ["DRIVER", "PRODUCTS", "VENDOR", "Tac02", "Tac02Options"]

VENDOR = 0x2FE3
PRODUCTS = {"left": 0x0100, "right": 0x0102}
_ENDPOINT = 0x81
# Frames come 1 ms apart at the fastest and are sent without a pause.
_PAUSE_S = 0.0005
# Of a transfer that ends with the frame's first packet, the rest comes with the next one.
_BEGUN = (0, 64)
_BATCH_S = 0.01
_SILENT_S = 0.5
_BROKEN_SHARE = 0.01


class Tac02Options(BaseModel):
    """A TAC-02 in a rig file."""

    model_config = ConfigDict(extra="forbid", strict=True)

    side: Literal["left", "right"]
    """The two have different product numbers, by which they are found."""
    port: str | None = None
    """A serial port to read in place of the USB device."""
    serial: str | None = None
    """Serial number, where several are plugged in."""
    rate_hz: int | None = Field(default=None, ge=1, le=2000)
    """Frames per second that it should deliver, if that is known."""


class _Source(Protocol):
    def receive(self, timeout_s: float) -> bytes: ...

    def close(self) -> None: ...


class Tac02:
    """The driver.

    Parameters
    ----------
    options : Tac02Options
    """

    def __init__(self, options: Tac02Options) -> None:
        self._options = options
        self._source: _Source | None = None
        self._forget()
        self.ports = (
            Port(
                name="taxels",
                kind="taxels",
                payload=Rows({"data": ("<i2", GRID)}),
                stamp_point="user_rx",
                nominal_rate=None if options.rate_hz is None else str(options.rate_hz),
                sensor=Sensor(
                    model="tac-02",
                    manufacturer="TACNIQ",
                    side=options.side,
                    serial=options.serial,
                ),
                valid=tuple(tuple(row) for row in VALID.tolist()),
                metadata={
                    "grid": list(GRID),
                    "unit": "adc",
                    "sign": -1,
                    "offset": float(OFFSET),
                },
            ),
        )

    def _forget(self) -> None:
        self._cutter = FrameCutter()
        self._frames = 0
        self._peak = 0
        self._last_s = time.monotonic()

    def open(self) -> None:
        """Open the device; what it sent before is not read.

        Raises
        ------
        DeviceError
            It is not there, may not be used, is in use, or is open already.
        MissingExtraError
            A serial port is asked for, and pyserial is not installed.
        """
        if self._source is not None:
            raise DeviceError("the taxels are open already", where=self._where())
        self._source = self._find()
        self._forget()

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Return the frames that came, at most 10 ms of them.

        Raises
        ------
        DeviceLostError
            The device is gone.
        DeviceError
            It is not open.
        """
        source = self._source
        if source is None:
            raise DeviceError("the taxels are not open", where=self._where())
        began_s = time.monotonic()
        until_s, full_s = began_s + timeout_s, began_s + min(timeout_s, _BATCH_S)
        frames: list[tuple[int, bytes]] = []
        left_s = timeout_s
        while True:
            # A serial port's burst goes on until a pause; a transfer ends by itself.
            within = self._cutter.is_within
            chunk = source.receive(_PAUSE_S if within else max(left_s, 0.0))
            if chunk:
                frames += self._cutter.feed(chunk, time.monotonic_ns())
            elif within:
                self._cutter.pause()
            if self._options.port is None and self._cutter.held_bytes not in _BEGUN:
                self._cutter.pause()
            left_s = (full_s if frames else until_s) - time.monotonic()
            if left_s <= 0 and not self._cutter.is_within:
                return self._samples(frames)

    def health(self) -> Health:
        """Tell whether frames come, whole ones, and how hard the pad is pressed."""
        problems = []
        silent_s = time.monotonic() - self._last_s
        if self._source is not None and silent_s > _SILENT_S:
            problems.append(f"The {self._options.side} taxels have sent nothing for a while.")
        refused = self._cutter.refused
        if refused > _BROKEN_SHARE * (self._frames + refused):
            problems.append(
                f"Of the {self._options.side} taxels' frames {refused} came broken: "
                "check the plug, and whether the machine keeps up."
            )
        return Health(
            lost={"framing": refused},
            readings={"peak": self._peak},
            problems=tuple(problems),
        )

    def close(self) -> None:
        """Release the device."""
        source, self._source = self._source, None
        if source is not None:
            source.close()

    def _samples(self, frames: list[tuple[int, bytes]]) -> list[Sample | Event]:
        if not frames:
            return []
        values = decode(b"".join(frame for _, frame in frames))
        self._frames += len(frames)
        self._last_s = time.monotonic()
        self._peak = OFFSET - int(values[-1].min())
        rows = values.astype("<i2", copy=False)
        return [
            Sample("taxels", time_ns, row.tobytes())
            for (time_ns, _), row in zip(frames, rows, strict=True)
        ]

    def _find(self) -> _Source:
        if self._options.port is not None:
            from exumi_recorders.drivers.serial_port import SerialPort

            return SerialPort(self._options.port)
        try:
            from exumi_recorders.drivers.usb_endpoint import UsbEndpoint, find_devices
        except ModuleNotFoundError:  # fcntl
            raise DeviceError("a TAC-02 is recorded on Linux only") from None
        product = PRODUCTS[self._options.side]
        devices = find_devices(VENDOR, product)
        serial = self._options.serial
        if serial is not None:
            devices = [device for device in devices if device.serial == serial]
        if not devices:
            raise DeviceError(
                "there is no such device", where=self._where(), fix="Is it plugged in? See `lsusb`."
            )
        if len(devices) > 1:
            names = ", ".join(str(device.serial) for device in devices)
            raise DeviceError(
                f"there are {len(devices)} such devices",
                where=self._where(),
                fix=f"Say which with `serial`: {names}.",
            )
        return UsbEndpoint(devices[0], _ENDPOINT)

    def _where(self) -> str:
        return self._options.port or f"USB {VENDOR:04x}:{PRODUCTS[self._options.side]:04x}"


def _make(options: Any) -> Tac02:
    return Tac02(options)


DRIVER = DriverType("tac02", "TACNIQ TAC-02: 64 taxels.", Tac02Options, _make)
