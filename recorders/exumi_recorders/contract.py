"""What a driver of a device is, and what it delivers.

A driver opens a device, hands out samples with the time at which they were stamped, tells how the
device is, and closes it. It does nothing else: no files, no queues, no clocks but the hub's. What
the device said goes into a sample's payload as it came; what it means (a reference frame, a width
in metres) is worked out when an episode is finalised, from the calibration that is stored with it.

A package adds a driver with an entry point of the group ``exumi.drivers`` that leads to a
`DriverType`; `exumi_recorders.testing.check_driver` judges it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, Protocol, TypeAlias

from pydantic import BaseModel

from exumi_data.errors import ExumiError
from exumi_data.model.clock import StampPoint
from exumi_data.model.streams import Sensor

__all__ = [
    "Blocks",
    "DeviceError",
    "DeviceLostError",
    "Driver",
    "DriverType",
    "Event",
    "Files",
    "Health",
    "Payload",
    "Port",
    "Rows",
    "Sample",
    "Transform",
]

_NOTHING: Mapping[str, Any] = MappingProxyType({})


class DeviceError(ExumiError):
    """A device cannot be opened or does not do what it should."""


class DeviceLostError(DeviceError):
    """A device is gone, such as by its plug: opening it again may help."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Payloads that are one row of numbers, packed, little-endian.

    Attributes
    ----------
    arrays : mapping of str to (str, tuple of int)
        Data type (``<f8``, ``<u2`` ...) and shape of each array of the stream that a row holds, in
        the order of the bytes: ``data``, and ``raw`` where the device's own values are others.
        A port with a `Transform` has ``raw`` alone: its ``data`` is computed when the episode is
        finalised.
    """

    arrays: Mapping[str, tuple[str, tuple[int, ...]]]


@dataclass(frozen=True, slots=True)
class Files:
    """Payloads that are whole image files, kept byte for byte.

    Attributes
    ----------
    media_type : str
        ``image/jpeg``.
    height, width, channels : int
        Of the images, pixels.
    """

    height: int
    width: int
    channels: int
    media_type: Literal["image/jpeg"] = "image/jpeg"


@dataclass(frozen=True, slots=True)
class Blocks:
    """Payloads that are blocks of sound: signed 16-bit samples, interleaved, little-endian.

    Attributes
    ----------
    channels : int
    rate : str
        Samples per second and channel, a rational such as ``48000``.
    """

    channels: int
    rate: str


Payload: TypeAlias = Rows | Files | Blocks

Transform: TypeAlias = Literal["world_frame", "encoder_map"]
"""How ``data`` follows from ``raw``: poses of a headset's left-handed world, encoder counts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """One stream that a device delivers.

    Attributes
    ----------
    name : str
        Within the device, such as ``pose`` and ``headset``; the rig file says what the stream is
        called.
    kind : str
        A kind of the registry, or ``vendor:name``.
    payload : Payload
        What the samples' bytes are.
    stamp_point : str
        Where on its way a sample gets its host time (registry: stamp points).
    nominal_rate : str, optional
        Samples per second as a rational, as the maker states it.
    transform : {"world_frame", "encoder_map"}, optional
        How ``data`` follows from ``raw``.
    droppable : bool
        Whether samples may be dropped, counted, when the disk cannot keep up: images and sound,
        never poses, encoders or events.
    modulus : int, optional
        Where the device's sequence number wraps.
    time_device_unit : str, optional
        Unit of the device's own clock (registry: units), where samples have it.
    sensor : Sensor, optional
    valid : tuple of tuple of bool, optional
        Of taxels: which cells are alive, by row.
    lossy : str, optional
        What the driver itself had to lose, such as ``YUYV to JPEG 4:2:2 of quality 95``: it is
        listed among the lossy steps of the episode's source. None where the payload is what the
        device sent.
    metadata : mapping
        Other fields of the stream's metadata (`exumi_data.model`): `frames`, `raw`, `grid`,
        `components`, `unit` ...
    """

    name: str
    kind: str
    payload: Payload
    stamp_point: StampPoint
    nominal_rate: str | None = None
    transform: Transform | None = None
    droppable: bool = False
    modulus: int | None = None
    time_device_unit: str | None = None
    sensor: Sensor | None = None
    valid: tuple[tuple[bool, ...], ...] | None = None
    lossy: str | None = None
    metadata: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample of a port.

    Attributes
    ----------
    port : str
    time_host_ns : int
        CLOCK_MONOTONIC of the hub at the port's stamp point.
    payload : bytes
        As the port's `payload` says; never changed after.
    time_device_ns : int, optional
        The device's own clock in the port's `time_device_unit`, as it was sent.
    sequence : int, optional
        The device's own counter, as it was sent (wrapped); a jump is a loss, for certain.
    flags : int
        Bits of the registry that the driver knows of: ``invalid``, ``out_of_range``.
    """

    port: str
    time_host_ns: int
    payload: bytes
    time_device_ns: int | None = None
    sequence: int | None = None
    flags: int = 0


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at a device and is no sample. Never dropped.

    Attributes
    ----------
    name : str
        ``record_flag`` (detail: ``on``), ``world_frame`` (``pose``: x y z qx qy qz qw, as sent),
        ``controls`` (name to value), ``clock`` (how the device's clock stands to the hub's),
        ``key`` (``name``), ``restart`` (the device numbers the samples after it anew), or a name
        of the driver's own.
    time_host_ns : int
        CLOCK_MONOTONIC.
    detail : mapping
        JSON values.
    """

    name: str
    time_host_ns: int
    detail: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)


@dataclass(frozen=True, slots=True)
class Health:
    """How a device is now.

    Attributes
    ----------
    lost : mapping of str to int
        Samples known to be lost or refused since the device was opened, by cause: ``kernel``,
        ``sequence``, ``late``, ``crc``, ``rejected`` ... Each ``open`` counts from 0; only
        ``sequence`` may go down, where what was missed comes late. They reach the episode as
        differences.
        Of a device with several ports, a cause is counted at the first one that is recorded, but
        for a cause that is named ``<port>/<cause>``.
    readings : mapping
        What the operator may want to see: ``agc``, ``magnitude``, ``magnet``, ``exposure`` ...
    problems : tuple of str
        What the operator has to mend, in a sentence each; empty when all is well.
    stamp_sigma_ns : float, optional
        How well samples are stamped, such as the width of the bracket around a bus read.
    """

    lost: Mapping[str, int] = field(default_factory=lambda: _NOTHING)
    readings: Mapping[str, float | int | str | bool] = field(default_factory=lambda: _NOTHING)
    problems: tuple[str, ...] = ()
    stamp_sigma_ns: float | None = None


class Driver(Protocol):
    """A device to record. One thread opens, reads and closes it; any may ask `health`."""

    @property
    def ports(self) -> tuple[Port, ...]:
        """What it delivers; final once the device is open."""

    def open(self) -> None:
        """Open the device and make it ready.

        Raises
        ------
        DeviceError
            It is not there, is in use, or is not what it should be; says what to do.
        """

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Return what has come, in the order of arrival; wait for the first, but not longer.

        Parameters
        ----------
        timeout_s : float
            Seconds, at most about a tenth of one.

        Raises
        ------
        DeviceLostError
            The device is gone.
        """

    def health(self) -> Health:
        """Tell how the device is, without delay."""

    def close(self) -> None:
        """Release the device; also after a failure, and a second time."""


@dataclass(frozen=True, slots=True)
class DriverType:
    """A driver that rig files can name.

    Attributes
    ----------
    name : str
        As in ``driver = "quest"``.
    text : str
        What it is, in a sentence.
    options : type
        Pydantic model of its part of the rig file; it forbids what it does not know.
    make : callable
        From options to a driver that is not open yet.
    """

    name: str
    text: str
    options: type[BaseModel]
    make: Callable[[Any], Driver]
