"""A V4L2 device in the words of recording: formats, rates, controls, frames with their stamps."""

import contextlib
import ctypes
import errno
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from exumi_data.time import NS_PER_S
from exumi_recorders.contract import DeviceError, DeviceLostError
from exumi_recorders.drivers import v4l2
from exumi_recorders.drivers.v4l2 import Io

__all__ = ["Control", "Offer", "RawFrame", "VideoDevice", "control_id"]

_GONE = (errno.ENODEV, errno.EIO, errno.ENXIO, errno.EBADF, errno.ESHUTDOWN)
_KINDS = {errno.ENODEV: DeviceLostError, errno.ENOTTY: v4l2.InterfaceError}
_NOT_YET = (errno.EAGAIN, errno.EINTR)
_MOST = 1024  # entries of a list that a driver gives; a broken one never ends
_US = 1000
_FEWEST_BUFFERS = 4

# As v4l2-ctl names them; kernels before 5.17 had the second names.
_CONTROL_IDS = {
    "brightness": 0x0098_0900,
    "contrast": 0x0098_0901,
    "saturation": 0x0098_0902,
    "hue": 0x0098_0903,
    "white_balance_automatic": 0x0098_090C,
    "white_balance_temperature_auto": 0x0098_090C,
    "gamma": 0x0098_0910,
    "gain_automatic": 0x0098_0912,
    "gain": 0x0098_0913,
    "power_line_frequency": 0x0098_0918,
    "white_balance_temperature": 0x0098_091A,
    "sharpness": 0x0098_091B,
    "backlight_compensation": 0x0098_091C,
    "auto_exposure": 0x009A_0901,
    "exposure_auto": 0x009A_0901,
    "exposure_time_absolute": 0x009A_0902,
    "exposure_absolute": 0x009A_0902,
    "exposure_dynamic_framerate": 0x009A_0903,
    "exposure_auto_priority": 0x009A_0903,
    "focus_absolute": 0x009A_090A,
    "focus_automatic_continuous": 0x009A_090C,
    "focus_auto": 0x009A_090C,
    "zoom_absolute": 0x009A_090D,
}
_NAMES: dict[int, str] = {}
for _name, _id in _CONTROL_IDS.items():
    _NAMES.setdefault(_id, _name)


def control_id(name: str) -> int | None:
    """Return the id of a control by the name that ``v4l2-ctl`` shows, or None."""
    return _CONTROL_IDS.get(name)


@dataclass(frozen=True, slots=True)
class Offer:
    """What a camera offers: a format and size, with its rates (empty where any is taken)."""

    pixel_format: int
    width: int
    height: int
    rates: tuple[Fraction, ...]

    def __str__(self) -> str:
        rates = ", ".join(f"{float(rate):g}" for rate in self.rates) or "any rate"
        return f"{v4l2.fourcc_text(self.pixel_format)} {self.width}x{self.height} @ {rates}"


@dataclass(frozen=True, slots=True)
class Control:
    """A control of a camera: its name as v4l2-ctl shows it, and its range."""

    id: int
    name: str
    minimum: int
    maximum: int
    default: int
    readable: bool
    writable: bool


@dataclass(frozen=True, slots=True)
class RawFrame:
    """A frame as the kernel hands it out."""

    data: bytes
    stamp_ns: int
    sequence: int
    flags: int

    @property
    def is_damaged(self) -> bool:
        """Whether the kernel says that the data may be damaged."""
        return bool(self.flags & v4l2.BUF_FLAG_ERROR)


class VideoDevice:
    """An opened camera.

    Parameters
    ----------
    path : str
        Such as ``/dev/video0``.
    io : Io
        The kernel.

    Raises
    ------
    DeviceError
        It is not there, is in use, or is no camera that streams.
    """

    def __init__(self, path: str, io: Io) -> None:
        self.path = path
        self._io = io
        self._maps: list[Any] = []
        self._streaming = False
        self.buffer_flags = 0
        try:
            self._fd = io.open(path)
        except OSError as error:
            raise DeviceError(
                f"cannot open the camera {path} ({error.strerror or error})",
                fix="Check the cable and that you are in the group `video`.",
            ) from None
        try:
            self.card = self._check_capability()
        except BaseException:
            self.close()
            raise

    def _check_capability(self) -> str:
        found = v4l2.Capability()
        self._call(v4l2.VIDIOC_QUERYCAP, found, "is no V4L2 device")
        whole = found.capabilities
        able = found.device_caps if whole & v4l2.CAP_DEVICE_CAPS else whole
        if not (able & v4l2.CAP_VIDEO_CAPTURE and able & v4l2.CAP_STREAMING):
            raise DeviceError(
                f"{self.path} gives no images (a camera has several devices, one of them does)",
                fix="Name the camera by its USB id, or take the first of its devices.",
            )
        return bytes(found.card).decode("utf-8", "replace")

    def _call(self, request: int, argument: Any, failure: str) -> None:
        try:
            self._io.ioctl(self._fd, request, argument)
        except OSError as error:
            what = f"the camera {self.path} {failure} ({error.strerror or error})"
            if error.errno == errno.EBUSY:
                raise DeviceError(what, fix="Another program uses it: end that one.") from None
            raise _KINDS.get(error.errno or 0, DeviceError)(what) from None

    def _listed(self, request: int, make: Any) -> Iterator[Any]:
        """Yield what a driver enumerates by an index, until it says that there is no more."""
        for index in range(_MOST):
            entry = make(index)
            try:
                self._io.ioctl(self._fd, request, entry)
            except OSError as error:
                if error.errno == errno.ENODEV:
                    raise DeviceLostError(f"the camera {self.path} is gone") from None
                return
            yield entry

    def offers(self) -> list[Offer]:
        """List formats, sizes and rates. Of ranges the ends are listed."""
        found = []
        formats = self._listed(
            v4l2.VIDIOC_ENUM_FMT,
            lambda i: v4l2.FormatDescription(index=i, type=v4l2.BUF_TYPE_VIDEO_CAPTURE),
        )
        for pixel_format in [entry.pixelformat for entry in formats]:
            for width, height in self._sizes(pixel_format):
                rates = self._rates(pixel_format, width, height)
                found.append(Offer(pixel_format, width, height, rates))
        return found

    def _sizes(self, pixel_format: int) -> list[tuple[int, int]]:
        sizes: list[tuple[int, int]] = []
        for entry in self._listed(
            v4l2.VIDIOC_ENUM_FRAMESIZES,
            lambda i: v4l2.FrameSize(index=i, pixel_format=pixel_format),
        ):
            values = entry.values
            if entry.type == v4l2.FRAME_DISCRETE:
                sizes.append((values[0], values[1]))
            else:
                sizes += [(values[0], values[3]), (values[1], values[4])]
                break
        return sizes

    def _rates(self, pixel_format: int, width: int, height: int) -> tuple[Fraction, ...]:
        rates = []
        for entry in self._listed(
            v4l2.VIDIOC_ENUM_FRAMEINTERVALS,
            lambda i: v4l2.FrameInterval(
                index=i, pixel_format=pixel_format, width=width, height=height
            ),
        ):
            pairs = [(0, 1)] if entry.type == v4l2.FRAME_DISCRETE else [(0, 1), (2, 3)]
            for above, below in pairs:
                if entry.values[above] and entry.values[below]:
                    rates.append(Fraction(entry.values[below], entry.values[above]))
            if entry.type != v4l2.FRAME_DISCRETE:
                break
        return tuple(sorted(set(rates), reverse=True))

    def set_format(self, pixel_format: int, width: int, height: int) -> int:
        """Ask for a format; return the bytes in a line (of formats that have lines).

        Raises
        ------
        DeviceError
            The camera gives another one.
        """
        request = v4l2.PixFormatRequest(type=v4l2.BUF_TYPE_VIDEO_CAPTURE)
        pix = request.fmt.pix
        pix.width, pix.height, pix.pixelformat = width, height, pixel_format
        pix.field = v4l2.FIELD_ANY
        self._call(v4l2.VIDIOC_S_FMT, request, "takes no format")
        if (pix.pixelformat, pix.width, pix.height) != (pixel_format, width, height):
            given = f"{v4l2.fourcc_text(pix.pixelformat)} {pix.width}x{pix.height}"
            raise DeviceError(
                f"the camera {self.path} gives {given} where "
                f"{v4l2.fourcc_text(pixel_format)} {width}x{height} was asked for"
            )
        return int(pix.bytesperline)

    def set_rate(self, rate: Fraction) -> Fraction | None:
        """Ask for a rate, images per second; return the one given, None if there is no choice."""
        request = v4l2.StreamParameters(type=v4l2.BUF_TYPE_VIDEO_CAPTURE)
        capture = request.parm.capture
        capture.numerator, capture.denominator = rate.denominator, rate.numerator
        self._call(v4l2.VIDIOC_S_PARM, request, "takes no rate")
        if not capture.capability & v4l2.CAP_TIMEPERFRAME or not capture.numerator:
            return None
        return Fraction(capture.denominator, capture.numerator)

    def start(self, buffers: int) -> None:
        """Map buffers, hand them to the kernel and start; `buffer_flags` are those of the stamps.

        Raises
        ------
        DeviceError
            There is no memory or no bandwidth for it.
        """
        request = v4l2.RequestBuffers(
            count=buffers, type=v4l2.BUF_TYPE_VIDEO_CAPTURE, memory=v4l2.MEMORY_MMAP
        )
        self._call(v4l2.VIDIOC_REQBUFS, request, "is in use, or gives no buffers")
        if request.count < _FEWEST_BUFFERS:
            raise DeviceError(
                f"the kernel gives {request.count} buffers for the camera {self.path}, it takes "
                f"{_FEWEST_BUFFERS} to lose no image",
                fix="Ask for smaller images.",
            )
        for index in range(request.count):
            buffer = self._buffer(index)
            self._call(v4l2.VIDIOC_QUERYBUF, buffer, "gives no buffers")
            self._maps.append(self._io.mmap(self._fd, buffer.length, buffer.m.offset))
            self.buffer_flags = buffer.flags
            self._call(v4l2.VIDIOC_QBUF, buffer, "takes no buffers")
        # A camera on a hub with others fails here when the bus has no bandwidth left.
        on = ctypes.c_int(v4l2.BUF_TYPE_VIDEO_CAPTURE)
        try:
            self._io.ioctl(self._fd, v4l2.VIDIOC_STREAMON, on)
        except OSError as error:
            if error.errno == errno.ENOSPC:
                raise DeviceError(
                    f"the USB bus has no bandwidth left for the camera {self.path}",
                    fix="Put cameras on USB controllers of their own, or lower size or rate.",
                ) from None
            raise DeviceError(
                f"the camera {self.path} does not start ({error.strerror or error})"
            ) from None
        self._streaming = True

    @staticmethod
    def _buffer(index: int = 0) -> v4l2.Buffer:
        return v4l2.Buffer(index=index, type=v4l2.BUF_TYPE_VIDEO_CAPTURE, memory=v4l2.MEMORY_MMAP)

    def wait(self, timeout_s: float) -> bool:
        """Wait for a frame or the camera's end; tell whether there is any."""
        return self._io.poll(self._fd, timeout_s)

    def take(self) -> RawFrame | None:
        """Return the oldest frame, its bytes copied once, or None when there is none yet.

        Raises
        ------
        DeviceLostError
            The camera is gone.
        """
        buffer = self._buffer()
        try:
            self._io.ioctl(self._fd, v4l2.VIDIOC_DQBUF, buffer)
            frame = RawFrame(
                data=bytes(self._maps[buffer.index][: buffer.bytesused]),
                stamp_ns=buffer.seconds * NS_PER_S + buffer.microseconds * _US,
                sequence=buffer.sequence,
                flags=buffer.flags,
            )
            self._io.ioctl(self._fd, v4l2.VIDIOC_QBUF, buffer)
        except OSError as error:
            if error.errno in _NOT_YET:
                return None
            kind = DeviceLostError if error.errno in _GONE else DeviceError
            raise kind(f"the camera {self.path} is gone ({error.strerror or error})") from None
        return frame

    def controls(self) -> dict[str, Control]:
        """Return the controls that have a number as their value, by name."""
        found: dict[str, Control] = {}
        number = 0
        for _ in range(_MOST):
            entry = v4l2.QueryExtControl(id=number | v4l2.CTRL_FLAG_NEXT_CTRL)
            try:
                self._io.ioctl(self._fd, v4l2.VIDIOC_QUERY_EXT_CTRL, entry)
            except OSError:
                break
            if entry.id <= number:
                break
            number = entry.id
            if entry.flags & v4l2.CTRL_FLAG_DISABLED or entry.type not in v4l2.CTRL_NUMBERS:
                continue
            name = _NAMES.get(entry.id) or _plain(bytes(entry.name))
            found[name] = Control(
                id=entry.id,
                name=name,
                minimum=entry.minimum,
                maximum=entry.maximum,
                default=entry.default_value,
                readable=not entry.flags & v4l2.CTRL_FLAG_WRITE_ONLY,
                writable=not entry.flags & v4l2.CTRL_FLAG_READ_ONLY,
            )
        return found

    def get_control(self, number: int) -> int | None:
        """Return a control's value, or None where it cannot be read."""
        return self._control(v4l2.VIDIOC_G_EXT_CTRLS, number, 0)

    def set_control(self, number: int, value: int) -> bool:
        """Set a control; tell whether the camera took it (a value of its own choice included)."""
        return self._control(v4l2.VIDIOC_S_EXT_CTRLS, number, value) is not None

    def _control(self, request: int, number: int, value: int) -> int | None:
        control = v4l2.ExtControl(id=number, value=value)
        # which = 0: any class, one control at a time, so that a failure has a name.
        both = v4l2.ExtControls(count=1, controls=ctypes.pointer(control))
        try:
            self._io.ioctl(self._fd, request, both)
        except OSError as error:
            if error.errno == errno.ENODEV:
                raise DeviceLostError(f"the camera {self.path} is gone") from None
            return None
        return int(control.value)

    def close(self) -> None:
        """Stop and release the device; also after a failure, and a second time."""
        if getattr(self, "_fd", -1) < 0:
            return
        if self._streaming:
            self._streaming = False
            with contextlib.suppress(OSError):  # it may be gone already
                off = ctypes.c_int(v4l2.BUF_TYPE_VIDEO_CAPTURE)
                self._io.ioctl(self._fd, v4l2.VIDIOC_STREAMOFF, off)
        for mapped in self._maps:
            mapped.close()
        self._maps = []
        fd, self._fd = self._fd, -1
        with contextlib.suppress(OSError):
            self._io.close(fd)


def _plain(name: bytes) -> str:
    """Return a control's name as v4l2-ctl shows it: lower case, words joined by ``_``."""
    text = name.decode("utf-8", "replace").lower()
    return "_".join("".join(c if c.isalnum() else " " for c in text).split())
