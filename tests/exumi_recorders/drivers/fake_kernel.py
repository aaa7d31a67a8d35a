"""A kernel with one camera: what `v4l2.Io` asks for, answered as uvcvideo answers it."""

import errno
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from exumi_recorders.drivers import v4l2

MONOTONIC_SOE = v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC | v4l2.BUF_FLAG_TSTAMP_SRC_SOE


@dataclass
class FakeControl:
    """A control: `holds` is false for one that stays as it is, whatever is set."""

    id: int
    name: bytes
    value: int
    minimum: int = 0
    maximum: int = 1000
    holds: bool = True
    flags: int = 0


@dataclass
class Filled:
    """A frame that waits to be taken."""

    data: bytes
    stamp_ns: int
    sequence: int
    flags: int = 0


@dataclass
class FakeKernel:
    """Answers every call; tests put frames in `waiting`."""

    modes: dict[int, list[tuple[int, int, list[int]]]] = field(
        default_factory=lambda: {v4l2.FOURCC_MJPG: [(64, 48, [30, 15]), (1280, 720, [30])]}
    )
    controls: list[FakeControl] = field(default_factory=list)
    buffer_flags: int = MONOTONIC_SOE
    waiting: list[Filled] = field(default_factory=list)
    failing: dict[int, int] = field(default_factory=dict)
    on_poll: Callable[["FakeKernel"], None] | None = None
    gone: bool = False
    line_padding: int = 0
    most_buffers: int = 32
    rate_given: Fraction | None = None
    queued: list[int] = field(default_factory=list)
    calls: list[str] = field(default_factory=list)
    maps: list[bytearray] = field(default_factory=list)
    opened: int = 0
    closed: int = 0

    def open(self, path: str) -> int:
        if self.gone:
            raise OSError(errno.ENOENT, "No such file or directory", path)
        self.opened += 1
        self.queued.clear()
        return 7

    def close(self, fd: int) -> None:
        self.closed += 1

    def mmap(self, fd: int, length: int, offset: int) -> Any:
        return FakeMap(self.maps[offset // 0x1000])

    def poll(self, fd: int, timeout_s: float) -> bool:
        if self.on_poll is not None:
            self.on_poll(self)
        return bool(self.waiting) or self.gone

    def ioctl(self, fd: int, request: int, argument: Any) -> None:
        name = {number: name for name, number in v4l2.IOCTLS.items()}[request]
        self.calls.append(name)
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")
        if request in self.failing:
            raise OSError(self.failing[request], "made to fail")
        getattr(self, "_" + name.removeprefix("VIDIOC_").lower())(argument)

    def _querycap(self, found: Any) -> None:
        found.card = b"Fake Camera"
        found.capabilities = v4l2.CAP_DEVICE_CAPS
        found.device_caps = v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_STREAMING

    @staticmethod
    def _entry(entries: list[Any], index: int) -> Any:
        if index >= len(entries):
            raise OSError(errno.EINVAL, "Invalid argument")
        return entries[index]

    def _enum_fmt(self, found: Any) -> None:
        found.pixelformat = self._entry(list(self.modes), found.index)

    def _enum_framesizes(self, found: Any) -> None:
        width, height, _ = self._entry(self.modes[found.pixel_format], found.index)
        found.type = v4l2.FRAME_DISCRETE
        found.values[0], found.values[1] = width, height

    def _enum_frameintervals(self, found: Any) -> None:
        rates = [
            r for w, h, r in self.modes[found.pixel_format] if (w, h) == (found.width, found.height)
        ]
        rate = self._entry(rates[0], found.index)
        found.type = v4l2.FRAME_DISCRETE
        found.values[0], found.values[1] = 1, rate

    def _s_fmt(self, request: Any) -> None:
        pix = request.fmt.pix
        if pix.pixelformat == v4l2.FOURCC_YUYV:
            pix.bytesperline = 2 * pix.width + self.line_padding

    def _s_parm(self, request: Any) -> None:
        request.parm.capture.capability = v4l2.CAP_TIMEPERFRAME
        if self.rate_given is not None:
            request.parm.capture.numerator = self.rate_given.denominator
            request.parm.capture.denominator = self.rate_given.numerator

    def _reqbufs(self, request: Any) -> None:
        request.count = min(request.count, self.most_buffers)
        self.maps = [bytearray(1 << 16) for _ in range(request.count)]

    def _querybuf(self, buffer: Any) -> None:
        buffer.length = len(self.maps[buffer.index])
        buffer.m.offset = buffer.index * 0x1000
        buffer.flags = self.buffer_flags

    def _qbuf(self, buffer: Any) -> None:
        self.queued.append(buffer.index)

    def _dqbuf(self, buffer: Any) -> None:
        if not self.waiting:
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")
        frame, index = self.waiting.pop(0), self.queued.pop(0)
        self.maps[index][: len(frame.data)] = frame.data
        buffer.index, buffer.bytesused = index, len(frame.data)
        buffer.seconds, rest = divmod(frame.stamp_ns, 1_000_000_000)
        buffer.microseconds, buffer.sequence = rest // 1000, frame.sequence
        buffer.flags = self.buffer_flags | frame.flags

    def _streamon(self, _: Any) -> None:
        assert len(self.queued) == len(self.maps) >= 4

    def _streamoff(self, _: Any) -> None:
        self.queued.clear()

    def _query_ext_ctrl(self, entry: Any) -> None:
        after = entry.id & ~v4l2.CTRL_FLAG_NEXT_CTRL
        later = sorted((c for c in self.controls if c.id > after), key=lambda c: c.id)
        control = self._entry(later, 0)
        entry.id, entry.type, entry.name = control.id, 1, control.name
        entry.minimum, entry.maximum, entry.flags = control.minimum, control.maximum, control.flags

    def _one(self, both: Any) -> tuple[Any, FakeControl]:
        assert both.count == 1
        wanted = both.controls[0]
        return wanted, next(c for c in self.controls if c.id == wanted.id)

    def _g_ext_ctrls(self, both: Any) -> None:
        wanted, control = self._one(both)
        wanted.value = control.value

    def _s_ext_ctrls(self, both: Any) -> None:
        wanted, control = self._one(both)
        if control.holds:
            control.value = wanted.value


class FakeMap:
    """A mapped buffer."""

    def __init__(self, memory: bytearray) -> None:
        self._memory: bytearray | None = memory

    def __getitem__(self, part: slice) -> bytes:
        assert self._memory is not None, "read after it was unmapped"
        return bytes(self._memory[part])

    def close(self) -> None:
        self._memory = None
