"""The kernel's interface to cameras: structs, ioctl numbers and the four calls that use them.

Only what recording needs, as ``linux/videodev2.h`` has it on 64-bit machines: on 32-bit ones the
structs with times and pointers have other sizes, and `check_machine` refuses.
"""

import ctypes
import mmap
import os
import select
import sys
from types import MappingProxyType
from typing import Any, Final, Protocol

from exumi_recorders.contract import DeviceError

__all__ = [
    "FOURCC_MJPG",
    "FOURCC_YUYV",
    "IOCTLS",
    "STRUCTS",
    "Buffer",
    "Capability",
    "ExtControl",
    "ExtControls",
    "FormatDescription",
    "FrameInterval",
    "FrameSize",
    "InterfaceError",
    "Io",
    "KernelIo",
    "PixFormat",
    "PixFormatRequest",
    "QueryExtControl",
    "RequestBuffers",
    "StreamParameters",
    "check_machine",
    "fourcc",
    "fourcc_text",
]

_u8, _u32, _s32 = ctypes.c_uint8, ctypes.c_uint32, ctypes.c_int32
_u64, _s64, _long = ctypes.c_uint64, ctypes.c_int64, ctypes.c_long


class InterfaceError(DeviceError):
    """The kernel's calls cannot be used here: another way to the camera may do."""


BUF_TYPE_VIDEO_CAPTURE: Final = 1
MEMORY_MMAP: Final = 1
FIELD_ANY: Final = 0

CAP_VIDEO_CAPTURE: Final = 0x1
CAP_STREAMING: Final = 0x0400_0000
CAP_DEVICE_CAPS: Final = 0x8000_0000
CAP_TIMEPERFRAME: Final = 0x1000

BUF_FLAG_ERROR: Final = 0x40
BUF_FLAG_TIMESTAMP_MASK: Final = 0xE000
BUF_FLAG_TIMESTAMP_MONOTONIC: Final = 0x2000
BUF_FLAG_TSTAMP_SRC_MASK: Final = 0x7_0000
BUF_FLAG_TSTAMP_SRC_SOE: Final = 0x1_0000

FRAME_DISCRETE: Final = 1

CTRL_FLAG_DISABLED: Final = 0x1
CTRL_FLAG_READ_ONLY: Final = 0x4
CTRL_FLAG_WRITE_ONLY: Final = 0x40
CTRL_FLAG_NEXT_CTRL: Final = 0x8000_0000
CTRL_NUMBERS: Final = (1, 2, 3, 9)  # integer, boolean, menu, menu of integers


def fourcc(text: str) -> int:
    """Return a pixel format's number, such as that of ``MJPG``."""
    return int.from_bytes(text.encode("ascii"), "little")


def fourcc_text(number: int) -> str:
    """Return a pixel format's four letters."""
    return (number & 0x7FFF_FFFF).to_bytes(4, "little").decode("ascii", "replace")


FOURCC_MJPG: Final = fourcc("MJPG")
FOURCC_YUYV: Final = fourcc("YUYV")


class Capability(ctypes.Structure):
    """``v4l2_capability``: what a device is."""

    _fields_ = (
        ("driver", ctypes.c_char * 16),
        ("card", ctypes.c_char * 32),
        ("bus_info", ctypes.c_char * 32),
        ("version", _u32),
        ("capabilities", _u32),
        ("device_caps", _u32),
        ("reserved", _u32 * 3),
    )


class FormatDescription(ctypes.Structure):
    """``v4l2_fmtdesc``: one pixel format that is offered."""

    _fields_ = (
        ("index", _u32),
        ("type", _u32),
        ("flags", _u32),
        ("description", ctypes.c_char * 32),
        ("pixelformat", _u32),
        ("mbus_code", _u32),
        ("reserved", _u32 * 3),
    )


class FrameSize(ctypes.Structure):
    """``v4l2_frmsizeenum``: one size of a format, or a range of them."""

    _fields_ = (
        ("index", _u32),
        ("pixel_format", _u32),
        ("type", _u32),
        # discrete: width, height; else min, max and step of the width, then of the height
        ("values", _u32 * 6),
        ("reserved", _u32 * 2),
    )


class FrameInterval(ctypes.Structure):
    """``v4l2_frmivalenum``: one frame interval of a size, or a range of them."""

    _fields_ = (
        ("index", _u32),
        ("pixel_format", _u32),
        ("width", _u32),
        ("height", _u32),
        ("type", _u32),
        # discrete: numerator, denominator; else those of min, max and step
        ("values", _u32 * 6),
        ("reserved", _u32 * 2),
    )


class PixFormat(ctypes.Structure):
    """``v4l2_pix_format``."""

    _fields_ = (
        ("width", _u32),
        ("height", _u32),
        ("pixelformat", _u32),
        ("field", _u32),
        ("bytesperline", _u32),
        ("sizeimage", _u32),
        ("colorspace", _u32),
        ("priv", _u32),
        ("flags", _u32),
        ("ycbcr_enc", _u32),
        ("quantization", _u32),
        ("xfer_func", _u32),
    )


class _FormatUnion(ctypes.Union):
    # The kernel's union holds a pointer: that is what aligns it to 8 bytes.
    _fields_ = (("pix", PixFormat), ("raw", _u8 * 200), ("alignment", ctypes.c_void_p))


class PixFormatRequest(ctypes.Structure):
    """``v4l2_format``."""

    _fields_ = (("type", _u32), ("fmt", _FormatUnion))


class _CaptureParameters(ctypes.Structure):
    _fields_ = (
        ("capability", _u32),
        ("capturemode", _u32),
        ("numerator", _u32),
        ("denominator", _u32),
        ("extendedmode", _u32),
        ("readbuffers", _u32),
        ("reserved", _u32 * 4),
    )


class _ParametersUnion(ctypes.Union):
    _fields_ = (("capture", _CaptureParameters), ("raw", _u8 * 200))


class StreamParameters(ctypes.Structure):
    """``v4l2_streamparm``: the frame interval."""

    _fields_ = (("type", _u32), ("parm", _ParametersUnion))


class RequestBuffers(ctypes.Structure):
    """``v4l2_requestbuffers``."""

    _fields_ = (
        ("count", _u32),
        ("type", _u32),
        ("memory", _u32),
        ("capabilities", _u32),
        ("flags", _u8),
        ("reserved", _u8 * 3),
    )


class _TimeCode(ctypes.Structure):
    _fields_ = (("type", _u32), ("flags", _u32), ("fields", _u8 * 8))


class _BufferMemory(ctypes.Union):
    _fields_ = (("offset", _u32), ("userptr", ctypes.c_ulong))


class Buffer(ctypes.Structure):
    """``v4l2_buffer``: one frame's buffer; its stamp is seconds and microseconds."""

    _fields_ = (
        ("index", _u32),
        ("type", _u32),
        ("bytesused", _u32),
        ("flags", _u32),
        ("field", _u32),
        ("seconds", _long),
        ("microseconds", _long),
        ("timecode", _TimeCode),
        ("sequence", _u32),
        ("memory", _u32),
        ("m", _BufferMemory),
        ("length", _u32),
        ("reserved2", _u32),
        ("request_fd", _s32),
    )


class QueryExtControl(ctypes.Structure):
    """``v4l2_query_ext_ctrl``: what a control is."""

    _fields_ = (
        ("id", _u32),
        ("type", _u32),
        ("name", ctypes.c_char * 32),
        ("minimum", _s64),
        ("maximum", _s64),
        ("step", _u64),
        ("default_value", _s64),
        ("flags", _u32),
        ("elem_size", _u32),
        ("elems", _u32),
        ("nr_of_dims", _u32),
        ("dims", _u32 * 4),
        ("reserved", _u32 * 32),
    )


class ExtControl(ctypes.Structure):
    """``v4l2_ext_control``: a control's value."""

    _pack_ = 1
    # `value` stands in a union of 8 bytes.
    _fields_ = (
        ("id", _u32),
        ("size", _u32),
        ("reserved2", _u32),
        ("value", _s32),
        ("rest_of_union", _u32),
    )


class ExtControls(ctypes.Structure):
    """``v4l2_ext_controls``: values to get or to set."""

    _fields_ = (
        ("which", _u32),
        ("count", _u32),
        ("error_idx", _u32),
        ("request_fd", _s32),
        ("reserved", _u32),
        ("controls", ctypes.POINTER(ExtControl)),
    )


STRUCTS: Final = MappingProxyType(
    {
        "v4l2_capability": (Capability, 104),
        "v4l2_fmtdesc": (FormatDescription, 64),
        "v4l2_frmsizeenum": (FrameSize, 44),
        "v4l2_frmivalenum": (FrameInterval, 52),
        "v4l2_pix_format": (PixFormat, 48),
        "v4l2_format": (PixFormatRequest, 208),
        "v4l2_streamparm": (StreamParameters, 204),
        "v4l2_requestbuffers": (RequestBuffers, 20),
        "v4l2_buffer": (Buffer, 88),
        "v4l2_query_ext_ctrl": (QueryExtControl, 232),
        "v4l2_ext_control": (ExtControl, 20),
        "v4l2_ext_controls": (ExtControls, 32),
    }
)
"""Each struct by the kernel's name, with its size there (64-bit)."""

_WRITE, _READ = 1, 2


def _ioctl(direction: int, number: int, size: int) -> int:
    return direction << 30 | size << 16 | ord("V") << 8 | number


def _both(number: int, struct: type[ctypes.Structure]) -> int:
    return _ioctl(_READ | _WRITE, number, ctypes.sizeof(struct))


VIDIOC_QUERYCAP: Final = _ioctl(_READ, 0, ctypes.sizeof(Capability))
VIDIOC_ENUM_FMT: Final = _both(2, FormatDescription)
VIDIOC_S_FMT: Final = _both(5, PixFormatRequest)
VIDIOC_REQBUFS: Final = _both(8, RequestBuffers)
VIDIOC_QUERYBUF: Final = _both(9, Buffer)
VIDIOC_QBUF: Final = _both(15, Buffer)
VIDIOC_DQBUF: Final = _both(17, Buffer)
VIDIOC_STREAMON: Final = _ioctl(_WRITE, 18, 4)
VIDIOC_STREAMOFF: Final = _ioctl(_WRITE, 19, 4)
VIDIOC_S_PARM: Final = _both(22, StreamParameters)
VIDIOC_G_EXT_CTRLS: Final = _both(71, ExtControls)
VIDIOC_S_EXT_CTRLS: Final = _both(72, ExtControls)
VIDIOC_ENUM_FRAMESIZES: Final = _both(74, FrameSize)
VIDIOC_ENUM_FRAMEINTERVALS: Final = _both(75, FrameInterval)
VIDIOC_QUERY_EXT_CTRL: Final = _both(103, QueryExtControl)

IOCTLS: Final = MappingProxyType(
    {
        "VIDIOC_QUERYCAP": VIDIOC_QUERYCAP,
        "VIDIOC_ENUM_FMT": VIDIOC_ENUM_FMT,
        "VIDIOC_S_FMT": VIDIOC_S_FMT,
        "VIDIOC_REQBUFS": VIDIOC_REQBUFS,
        "VIDIOC_QUERYBUF": VIDIOC_QUERYBUF,
        "VIDIOC_QBUF": VIDIOC_QBUF,
        "VIDIOC_DQBUF": VIDIOC_DQBUF,
        "VIDIOC_STREAMON": VIDIOC_STREAMON,
        "VIDIOC_STREAMOFF": VIDIOC_STREAMOFF,
        "VIDIOC_S_PARM": VIDIOC_S_PARM,
        "VIDIOC_G_EXT_CTRLS": VIDIOC_G_EXT_CTRLS,
        "VIDIOC_S_EXT_CTRLS": VIDIOC_S_EXT_CTRLS,
        "VIDIOC_ENUM_FRAMESIZES": VIDIOC_ENUM_FRAMESIZES,
        "VIDIOC_ENUM_FRAMEINTERVALS": VIDIOC_ENUM_FRAMEINTERVALS,
        "VIDIOC_QUERY_EXT_CTRL": VIDIOC_QUERY_EXT_CTRL,
    }
)
"""The numbers of the calls, by the kernel's name."""


def check_machine() -> None:
    """Refuse machines on which the structs have another layout.

    Raises
    ------
    InterfaceError
        Not a 64-bit machine, or not Linux.
    """
    if not sys.platform.startswith("linux"):
        raise InterfaceError("V4L2 cameras are read on Linux only")
    wrong = [name for name, (struct, size) in STRUCTS.items() if ctypes.sizeof(struct) != size]
    if wrong:
        raise InterfaceError(
            f"cameras are read on 64-bit Linux only ({wrong[0]} has another size here)",
            fix='Set backend = "pyav" for this camera.',
        )


class Io(Protocol):
    """What is asked of the kernel: everything below is the same for a camera and for a test."""

    def open(self, path: str) -> int:
        """Open a device for reading and writing without waiting; return its descriptor."""

    def ioctl(self, fd: int, request: int, argument: Any) -> None:
        """Do one call, which may change `argument`. Raises OSError."""

    def mmap(self, fd: int, length: int, offset: int) -> Any:
        """Map a buffer: an object whose slices are bytes, with ``close()``."""

    def poll(self, fd: int, timeout_s: float) -> bool:
        """Wait until there is a frame or an error, but not longer; tell whether there is."""

    def close(self, fd: int) -> None:
        """Close the device."""


class KernelIo:
    """The kernel itself."""

    def open(self, path: str) -> int:
        """Open a device.

        Raises
        ------
        InterfaceError
            This is no 64-bit Linux.
        OSError
            It cannot be opened.
        """
        check_machine()
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def ioctl(self, fd: int, request: int, argument: Any) -> None:
        """Do one call."""
        import fcntl  # there is none on Windows

        fcntl.ioctl(fd, request, argument)

    def mmap(self, fd: int, length: int, offset: int) -> mmap.mmap:
        """Map a buffer."""
        return mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, 0, offset)

    def poll(self, fd: int, timeout_s: float) -> bool:
        """Wait for a frame or an error."""
        poller = select.poll()
        poller.register(fd, select.POLLIN)
        return bool(poller.poll(max(0.0, timeout_s * 1e3)))

    def close(self, fd: int) -> None:
        """Close the device."""
        os.close(fd)
