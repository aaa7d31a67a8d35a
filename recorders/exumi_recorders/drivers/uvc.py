"""Cameras through V4L2: MJPEG bytes as they came, the kernel's stamps, its sequence numbers.

Of cameras that send YUYV only, the JPEG is made here, without changing size or chroma; this is
declared as a lossy step.
"""

import time
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path

from exumi_data.model.clock import StampPoint
from exumi_data.time import NS_PER_S
from exumi_recorders.contract import DeviceError
from exumi_recorders.drivers import v4l2
from exumi_recorders.drivers.camera import Frame, Shape
from exumi_recorders.drivers.v4l2 import Io, KernelIo
from exumi_recorders.drivers.video_device import Control, Offer, RawFrame, VideoDevice, control_id
from exumi_recorders.drivers.video_lookup import find_camera

__all__ = ["V4L2Source"]

_SEQUENCES = 1 << 32
_STALE_NS = 60 * NS_PER_S  # a stamp of another clock is years away
_RATE_TOLERANCE = Fraction(1, 100)
_QUALITY = 95
_LOSSY = f"YUYV to JPEG 4:2:2 of quality {_QUALITY}"


class V4L2Source:
    """Frames of a camera through V4L2.

    Parameters
    ----------
    device : str
        As `video_lookup.find_camera` takes it.
    buffers : int
        How many frames the kernel may keep, at least 4.
    lock : mapping of str to int
        Controls to set where the camera has them.
    controls : mapping of str to int
        Controls that the user asks for: one that is not there is a problem.
    io : Io, optional
        The kernel.
    system : pathlib.Path
        Where ``sysfs`` is.
    monotonic_ns : callable
        The hub's clock.
    """

    modulus: int | None = _SEQUENCES

    def __init__(
        self,
        device: str,
        *,
        buffers: int = 8,
        lock: Mapping[str, int],
        controls: Mapping[str, int],
        io: Io | None = None,
        system: Path = Path("/sys"),
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.stamp_point: StampPoint = "user_rx"
        self.serial: str | None = None
        self.lossy: str | None = None
        self._name = device
        self._buffers = buffers
        self._lock, self._controls = lock, controls
        self._io = io or KernelIo()
        self._system = system
        self._now_ns = monotonic_ns
        self._device: VideoDevice | None = None
        self._shape: Shape | None = None
        self._line_bytes = 0
        self._monotonic: bool | None = None  # not known before the first frame

    def open(self, shape: Shape) -> None:
        """Open the camera with the size and rate asked for, and start it.

        Raises
        ------
        DeviceError
            It is not there or in use, or does not offer them: what it offers is listed.
        """
        found = find_camera(self._name, self._system)
        self.serial = found.serial
        self._shape = shape
        self._device = device = VideoDevice(found.path, self._io)
        offers = device.offers()
        pixel_format = self._choose(offers, shape)
        self._line_bytes = device.set_format(pixel_format, shape.width, shape.height)
        self.lossy = None if pixel_format == v4l2.FOURCC_MJPG else _LOSSY
        given = device.set_rate(shape.rate)
        if given is not None and abs(given - shape.rate) > _RATE_TOLERANCE * shape.rate:
            raise DeviceError(
                f"the camera {found} gives {float(given):g} images/s where {float(shape.rate):g} "
                "were asked for",
                fix=_offered(offers),
            )
        device.start(self._buffers)
        self._judge_stamps(device.buffer_flags)

    def _choose(self, offers: list[Offer], shape: Shape) -> int:
        """Return the pixel format: the camera's JPEG where there is any of that size and rate."""
        for pixel_format in (v4l2.FOURCC_MJPG, v4l2.FOURCC_YUYV):
            for offer in offers:
                fits = (offer.pixel_format, offer.width, offer.height) == (
                    pixel_format,
                    shape.width,
                    shape.height,
                )
                if fits and (
                    not offer.rates or any(_same(rate, shape.rate) for rate in offer.rates)
                ):
                    return pixel_format
        raise DeviceError(
            f"the camera {self._name} does not offer {shape.width}x{shape.height} @ "
            f"{float(shape.rate):g} as MJPG or YUYV",
            fix=_offered(offers),
        )

    def _judge_stamps(self, flags: int) -> None:
        monotonic = flags & v4l2.BUF_FLAG_TIMESTAMP_MASK == v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC
        start = flags & v4l2.BUF_FLAG_TSTAMP_SRC_MASK == v4l2.BUF_FLAG_TSTAMP_SRC_SOE
        self._monotonic = None if monotonic else False
        self.stamp_point = ("buffer_soe" if start else "kernel_rx") if monotonic else "user_rx"

    def read(self, timeout_s: float) -> list[Frame]:
        """Return the frames that have come.

        Raises
        ------
        DeviceLostError
            The camera was unplugged.
        """
        device = self._device
        if device is None:
            raise DeviceError(f"the camera {self._name} is not open")
        if not device.wait(timeout_s):
            return []
        frames: list[Frame] = []
        # What has come is handed over even if the camera is gone by now: that is found next time.
        while (raw := device.take()) is not None:
            frames.append(self._frame(raw))
            if len(frames) >= self._buffers or not device.wait(0.0):
                break
        return frames

    def _frame(self, raw: RawFrame) -> Frame:
        now_ns = self._now_ns()
        if self._monotonic is None:
            # uvcvideo says monotonic also where it was told to stamp with the wall clock.
            self._monotonic = abs(now_ns - raw.stamp_ns) < _STALE_NS
            self.stamp_point = self.stamp_point if self._monotonic else "user_rx"
        stamp_ns = raw.stamp_ns if self._monotonic else now_ns
        if raw.is_damaged:
            return Frame(raw.data, stamp_ns, raw.sequence, fault="error")
        data = raw.data
        if self.lossy is not None:
            encoded = self._encoded(raw.data)
            if encoded is None:
                return Frame(raw.data, stamp_ns, raw.sequence, fault="rejected")
            data = encoded
        return Frame(data, stamp_ns, raw.sequence)

    def _encoded(self, data: bytes) -> bytes | None:
        """Return YUYV pixels as a JPEG with the same planes; None where some are missing."""
        import numpy as np
        import simplejpeg

        shape = self._shape
        if shape is None:
            return None
        line_bytes = self._line_bytes or 2 * shape.width
        if len(data) < line_bytes * shape.height:
            return None
        pixels = np.frombuffer(data, np.uint8, line_bytes * shape.height)
        lines = pixels.reshape(shape.height, line_bytes)[:, : 2 * shape.width]
        y, u, v = (np.ascontiguousarray(lines[:, a::b]) for a, b in ((0, 2), (1, 4), (3, 4)))
        return bytes(simplejpeg.encode_jpeg_yuv_planes(y, u, v, _QUALITY))

    def lock(self) -> tuple[dict[str, int], list[str]]:
        """Set the controls and read all of them back."""
        device = self._device
        if device is None:
            return {}, []
        there = device.controls()
        by_id = {control.id: control for control in there.values()}
        problems = []
        # What adjusts itself is turned off first: a value does not take while it is on.
        wanted: dict[str, int] = {}
        for name, value in (*self._lock.items(), *self._controls.items()):
            control = there.get(name) or by_id.get(control_id(name) or -1)
            if control is not None:
                wanted[control.name] = value  # the user's own word, also under an older name
            elif name in self._controls:
                problems.append(f"the camera has no control {name!r}: it has {', '.join(there)}")
        for name, value in wanted.items():
            problem = _set(device, there[name], value)
            if problem is not None:
                problems.append(problem)
        read = {
            name: device.get_control(control.id)
            for name, control in there.items()
            if control.readable
        }
        return {name: found for name, found in read.items() if found is not None}, problems

    def close(self) -> None:
        """Release the camera."""
        device, self._device = self._device, None
        if device is not None:
            device.close()


def _set(device: VideoDevice, control: Control, value: int) -> str | None:
    """Set a control and read it back; say what is wrong, if anything is."""
    if not control.minimum <= value <= control.maximum:
        return (
            f"the control {control.name} cannot be {value}: from {control.minimum} to "
            f"{control.maximum}"
        )
    if control.readable and device.get_control(control.id) == value:
        return None
    taken = control.writable and device.set_control(control.id, value)
    if not control.readable:
        return None if taken else f"the control {control.name} did not take {value}"
    found = device.get_control(control.id)
    return (
        None
        if found == value
        else f"the control {control.name} did not take {value}: it is {found}"
    )


def _same(rate: Fraction, other: Fraction) -> bool:
    return abs(rate - other) <= _RATE_TOLERANCE * other


def _fits(offer: Offer, shape: Shape) -> bool:
    if (offer.width, offer.height) != (shape.width, shape.height):
        return False
    return not offer.rates or any(_same(rate, shape.rate) for rate in offer.rates)


def _offered(offers: list[Offer]) -> str:
    return f"It offers: {'; '.join(map(str, offers)) or 'nothing'}."
