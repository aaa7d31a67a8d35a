"""A camera as a driver: whole JPEG files with their stamps, whatever they came through.

A frame is taken as it came, or refused and counted. What is refused would spoil the episode: data
that the kernel calls damaged, no JPEG from its first to its last marker, another size.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field

from exumi_data.errors import DamagedDataError
from exumi_data.model.base import Rational
from exumi_data.model.clock import StampPoint
from exumi_data.model.streams import Sensor
from exumi_data.store import jpeg
from exumi_data.time import NS_PER_S
from exumi_recorders.contract import DeviceError, Event, Files, Health, Port, Sample
from exumi_recorders.drivers.v4l2 import InterfaceError
from exumi_recorders.drivers.waiting import first_items

__all__ = [
    "CameraDriver",
    "CameraOptions",
    "CameraProfile",
    "CameraSource",
    "Frame",
    "Shape",
    "frame_fault",
]

_SILENT_NS = NS_PER_S
_AHEAD_NS = 1_000_000  # a stamp may not be later than now; reading two clocks takes a moment
_MOST_BUFFERS = 32


class CameraOptions(BaseModel):
    """A camera's part of a rig file. What is left out is as the driver's profile says.

    Attributes
    ----------
    device : str
        ``/dev/video0``, a path below ``/dev/v4l/by-id``, ``vendor:product:serial`` of USB, or
        ``unix:/path`` of a socket that delivers frames.
    width, height : int, optional
        Pixels.
    rate : str, optional
        Images per second, a rational.
    kind : {"tactile", "rgb"}, optional
    side : {"left", "right"}, optional
        Which finger a tactile sensor is on.
    sensor, serial : str, optional
        Registered name of the sensor's model, and its serial number; that of USB is found.
    controls : mapping of str to int
        Values by the name that ``v4l2-ctl -L`` shows, set and read back at start.
    backend : {"auto", "v4l2", "pyav"}
        ``auto`` is V4L2, and PyAV where the kernel refuses its calls.
    buffers : int
        How many frames the kernel may keep for us.
    start_timeout_s : float
        How long the first image may take.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    device: str = Field(min_length=1)
    width: int | None = Field(default=None, ge=1, le=16384)
    height: int | None = Field(default=None, ge=1, le=16384)
    rate: Rational | None = None
    kind: Literal["tactile", "rgb"] | None = None
    side: Literal["left", "right"] | None = None
    sensor: str | None = None
    serial: str | None = None
    controls: Mapping[str, int] = Field(default_factory=dict)
    backend: Literal["auto", "v4l2", "pyav"] = "auto"
    buffers: int = Field(default=8, ge=4, le=_MOST_BUFFERS)
    start_timeout_s: float = Field(default=5.0, gt=0.0, le=60.0)


@dataclass(frozen=True, slots=True)
class CameraProfile:
    """What is known of a kind of camera.

    Attributes
    ----------
    name, text : str
    kind : {"tactile", "rgb"}
    width, height : int
        Pixels.
    rate : str
        Images per second, as the maker states it.
    sensor : str, optional
        Registered name of the model.
    lock : mapping of str to int
        Controls to set where the camera has them: whatever would change by itself.
    modes : tuple of (int, int, str)
        Width, height and rate of all that it offers; empty where it is not known.
    """

    name: str
    text: str
    kind: Literal["tactile", "rgb"]
    width: int
    height: int
    rate: str
    sensor: str | None = None
    lock: Mapping[str, int] = field(default_factory=dict)
    modes: tuple[tuple[int, int, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Shape:
    """What is asked of a camera: size in pixels, images per second."""

    width: int
    height: int
    rate: Fraction


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of a source. `fault` says why it cannot be taken."""

    data: bytes
    stamp_ns: int
    sequence: int | None = None
    fault: str | None = None


class CameraSource(Protocol):
    """Where frames come from."""

    stamp_point: StampPoint
    """Where a frame gets its stamp; known once the source is open."""
    modulus: int | None
    """Where the sequence wraps; None where there is none, and losses cannot be known."""
    serial: str | None
    lossy: str | None
    """What was lost before the bytes came; None where they are the camera's own."""

    def open(self, shape: Shape) -> None:
        """Open it and let images come. Raises DeviceError."""

    def read(self, timeout_s: float) -> list[Frame]:
        """Return the frames that have come; wait for the first, but not longer.

        Raises DeviceLostError.
        """

    def lock(self) -> tuple[dict[str, int], list[str]]:
        """Set the controls; return what they are now, and what did not take, a sentence each."""

    def close(self) -> None:
        """Release it; also after a failure, and a second time."""


def frame_fault(data: bytes, size: tuple[int, int]) -> str | None:
    """Say why bytes are no whole JPEG of (height, width), in a word; None where they are."""
    if not jpeg.is_jpeg(data):
        return "rejected"
    try:
        found = jpeg.size_of(data)
    except DamagedDataError:
        return "rejected"
    return None if found[:2] == size else "size"


@dataclass(slots=True)
class _Counts:
    """What has happened since the camera was opened."""

    images: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    next_sequence: int | None = None
    last_stamp_ns: int | None = None
    last_seen_ns: int = 0

    def lose(self, cause: str, number: int = 1) -> None:
        # A new mapping: `health` may be reading the old one in another thread.
        self.lost = {**self.lost, cause: self.lost.get(cause, 0) + number}


class CameraDriver:
    """A camera, as the contract of drivers has it; its one port is ``images``.

    Parameters
    ----------
    profile : CameraProfile
    options : CameraOptions
    sources : callables
        Make the source; the next one is tried where one's interface is not there.
    monotonic_ns : callable
        The hub's clock.
    """

    def __init__(
        self,
        profile: CameraProfile,
        options: CameraOptions,
        sources: tuple[Callable[[], CameraSource], ...],
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._profile = profile
        self._options = options
        self._sources = sources
        self._now_ns = monotonic_ns
        self._shape = Shape(
            options.width or profile.width,
            options.height or profile.height,
            Fraction(options.rate or profile.rate),
        )
        self._source: CameraSource | None = None
        self._channels = 3
        self._counts = _Counts()
        self._ready: list[Sample | Event] = []
        self._controls: dict[str, int] = {}
        self._problems: tuple[str, ...] = ()
        self._stamp_point: StampPoint = "kernel_rx"

    @property
    def ports(self) -> tuple[Port, ...]:
        """The port ``images``."""
        source, options, profile = self._source, self._options, self._profile
        model = options.sensor or profile.sensor
        serial = options.serial or (source.serial if source else None)
        sensor = None
        if model is not None:
            sensor = Sensor(model=model, serial=serial, side=options.side)
        return (
            Port(
                name="images",
                kind=options.kind or profile.kind,
                payload=Files(self._shape.height, self._shape.width, self._channels),
                stamp_point=self._stamp_point,
                nominal_rate=options.rate or profile.rate,
                droppable=True,
                modulus=source.modulus if source else None,
                sensor=sensor,
                lossy=source.lossy if source else None,
            ),
        )

    def open(self) -> None:
        """Open the camera, lock its controls, and wait for the first image.

        Raises
        ------
        DeviceError
            It is not there, in use, does not offer what is asked of it, or sends no image.
        """
        self.close()
        self._check_modes()
        self._counts = _Counts(last_seen_ns=self._now_ns())
        self._ready, self._controls, self._problems = [], {}, ()
        self._source = self._open_source()
        try:
            # Some cameras forget their controls when they start: they are set again after it.
            self._source.lock()
            self._wait_for_first(self._source)
            controls, problems = self._source.lock()
        except BaseException:
            self.close()
            raise
        self._stamp_point = self._source.stamp_point
        self._controls, self._problems = controls, tuple(problems)
        if controls:
            self._ready.insert(0, Event("controls", self._now_ns(), dict(controls)))

    def _check_modes(self) -> None:
        shape, profile = self._shape, self._profile
        modes = [(w, h, Fraction(rate)) for w, h, rate in profile.modes]
        if modes and (shape.width, shape.height, shape.rate) not in modes:
            offered = "; ".join(f"{w}x{h} @ {float(rate):g}" for w, h, rate in modes)
            raise DeviceError(
                f"a {profile.name} gives no {shape.width}x{shape.height} @ {float(shape.rate):g}",
                fix=f"It gives: {offered}.",
            )

    def _open_source(self) -> CameraSource:
        failures: list[InterfaceError] = []
        for make in self._sources:
            source = make()
            try:
                source.open(self._shape)
            except InterfaceError as error:
                source.close()
                failures.append(error)
                continue
            except BaseException:
                source.close()
                raise
            return source
        raise failures[0]

    def _wait_for_first(self, source: CameraSource) -> None:
        end_ns = self._now_ns() + int(self._options.start_timeout_s * NS_PER_S)
        while self._now_ns() < end_ns:
            for frame in source.read(0.1):
                if not frame.fault and jpeg.is_jpeg(frame.data):
                    self._check_size(frame.data)
                self._take(frame)
            if self._counts.images:
                return
        refused = ", ".join(f"{n} {cause}" for cause, n in self._counts.lost.items())
        raise DeviceError(
            f"the camera {self._options.device} sent no image within "
            f"{self._options.start_timeout_s:g} s" + (f" (refused: {refused})" if refused else ""),
            fix="Plug it in again, on a USB controller of its own.",
        )

    def _check_size(self, data: bytes) -> None:
        """See from an image what the camera really sends: channels, and the size that was asked."""
        try:
            height, width, self._channels = jpeg.size_of(data)
        except DamagedDataError:
            return
        if (height, width) != (self._shape.height, self._shape.width):
            raise DeviceError(
                f"the camera {self._options.device} sends images of {width}x{height}, "
                f"{self._shape.width}x{self._shape.height} was asked for",
                fix="Correct `width` and `height` in the rig file.",
            )

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Return the images that have come; wait for the first, but not longer.

        Raises
        ------
        DeviceLostError
            The camera was unplugged.
        """
        source = self._source
        if source is None:
            raise DeviceError(f"the camera {self._options.device} is not open")

        def receive(left_s: float) -> list[Sample | Event]:
            if not self._ready:
                for frame in source.read(left_s):
                    self._take(frame)
            ready, self._ready = self._ready, []
            return ready

        return first_items(receive, timeout_s)

    def _take(self, frame: Frame) -> None:
        """Count a frame, and keep it unless something is wrong with it."""
        counts = self._counts
        counts.last_seen_ns = self._now_ns()
        self._count_sequence(frame.sequence)
        size = (self._shape.height, self._shape.width)
        fault = frame.fault or frame_fault(frame.data, size) or self._stamp_fault(frame.stamp_ns)
        if fault is not None:
            counts.lose(fault)
            return
        counts.images += 1
        counts.last_stamp_ns = frame.stamp_ns
        self._ready.append(Sample("images", frame.stamp_ns, frame.data, sequence=frame.sequence))

    def _count_sequence(self, sequence: int | None) -> None:
        counts, modulus = self._counts, self._source.modulus if self._source else None
        if sequence is None or modulus is None:
            return
        if counts.next_sequence is not None:
            missing = (sequence - counts.next_sequence) % modulus
            # More than half of the range is a step back: another counter, not a loss.
            if 0 < missing < modulus // 2:
                counts.lose("sequence", missing)
        counts.next_sequence = (sequence + 1) % modulus

    def _stamp_fault(self, stamp_ns: int) -> str | None:
        last = self._counts.last_stamp_ns
        ahead = stamp_ns > self._counts.last_seen_ns + _AHEAD_NS
        return "stamp" if ahead or (last is not None and stamp_ns <= last) else None

    def health(self) -> Health:
        """Tell images, losses, controls, and what did not take."""
        # Looked up once: the camera may be closed meanwhile.
        counts, source = self._counts, self._source
        problems = list(self._problems)
        silent_ns = self._now_ns() - counts.last_seen_ns
        if source is not None and silent_ns > _SILENT_NS:
            problems.append(f"no image for {silent_ns / NS_PER_S:.0f} s")
        readings: dict[str, Any] = {"images": counts.images}
        if source is not None and source.modulus is None:
            readings["losses_known"] = False
        return Health(
            lost=counts.lost,
            readings={**readings, **self._controls},
            problems=tuple(problems),
        )

    def close(self) -> None:
        """Release the camera."""
        source, self._source = self._source, None
        if source is not None:
            source.close()
