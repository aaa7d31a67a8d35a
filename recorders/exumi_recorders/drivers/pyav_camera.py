"""Cameras through PyAV (FFmpeg): where the V4L2 calls of `uvc` cannot be used.

The packets are the camera's bytes and their pts the kernel's stamps, in microseconds. There are no
sequence numbers, so losses cannot be known; no controls; and what the kernel called damaged is not
told.
"""

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from exumi_data.model.clock import StampPoint
from exumi_data.time import NS_PER_S
from exumi_recorders.contract import DeviceError, DeviceLostError
from exumi_recorders.drivers.camera import Frame, Shape
from exumi_recorders.drivers.video_lookup import find_camera

__all__ = ["PyavSource"]

_STALE_NS = 60 * NS_PER_S
_US = 1_000_000
_QUEUED = 32
_JOIN_S = 1.0


def _open(path: str, shape: Shape) -> Any:
    import av

    options = {
        "input_format": "mjpeg",
        "video_size": f"{shape.width}x{shape.height}",
        "framerate": str(shape.rate),
        "timestamps": "default",  # the kernel's, as they are
    }
    return av.open(path, format="v4l2", options=options)


class PyavSource:
    """Frames of a camera through PyAV.

    Parameters
    ----------
    device : str
        As `video_lookup.find_camera` takes it.
    controls : mapping of str to int
        Which the user asks for: none can be set this way, and that is a problem.
    open_container : callable
        Opens a path with a shape as an `av.container.InputContainer`.
    system : pathlib.Path
        Where ``sysfs`` is.
    monotonic_ns : callable
        The hub's clock.
    """

    modulus: int | None = None
    lossy: str | None = None

    def __init__(
        self,
        device: str,
        *,
        controls: Mapping[str, int],
        open_container: Callable[[str, Shape], Any] = _open,
        system: Path = Path("/sys"),
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.stamp_point: StampPoint = "kernel_rx"
        self.serial: str | None = None
        self._name = device
        self._controls = controls
        self._open_container = open_container
        self._system = system
        self._now_ns = monotonic_ns
        self._frames: queue.Queue[Frame] = queue.Queue(_QUEUED)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._monotonic: bool | None = None

    def open(self, shape: Shape) -> None:
        """Open the camera.

        Raises
        ------
        DeviceError
            FFmpeg cannot open it that way.
        """
        import av

        found = find_camera(self._name, self._system)
        self.serial = found.serial
        try:
            container = self._open_container(found.path, shape)
        except (OSError, ValueError, av.FFmpegError) as error:
            raise DeviceError(f"cannot open the camera {found} through PyAV ({error})") from None
        self._stop.clear()
        self._monotonic = None
        self._frames = queue.Queue(_QUEUED)
        # FFmpeg waits for a frame as long as it takes: that is why it has a thread of its own.
        self._thread = threading.Thread(
            target=self._demux, args=(container, self._frames), name="pyav-camera", daemon=True
        )
        self._thread.start()

    def _demux(self, container: Any, frames: "queue.Queue[Frame]") -> None:
        import av

        # An error of FFmpeg and the end of the stream are the same: the camera is gone.
        with container, contextlib.suppress(OSError, av.FFmpegError):
            for packet in container.demux(video=0):
                if self._stop.is_set():
                    return
                if packet.pts is not None and packet.size:
                    frame = Frame(bytes(packet), self._stamp_ns(packet))
                    with contextlib.suppress(queue.Full):
                        frames.put(frame, timeout=_JOIN_S)

    def _stamp_ns(self, packet: Any) -> int:
        now_ns = self._now_ns()
        stamp_ns = round(packet.pts * packet.time_base * _US) * (NS_PER_S // _US)
        if self._monotonic is None:
            self._monotonic = abs(now_ns - stamp_ns) < _STALE_NS
            self.stamp_point = "kernel_rx" if self._monotonic else "user_rx"
        return stamp_ns if self._monotonic else now_ns

    def read(self, timeout_s: float) -> list[Frame]:
        """Return the frames that have come.

        Raises
        ------
        DeviceLostError
            The camera is gone.
        """
        thread, found = self._thread, list[Frame]()
        # Asked first: what it has put there before it ended is taken below.
        has_ended = thread is None or not thread.is_alive()
        with contextlib.suppress(queue.Empty):
            found.append(self._frames.get(block=not has_ended, timeout=timeout_s))
            while True:
                found.append(self._frames.get_nowait())
        if has_ended and not found:
            raise DeviceLostError(f"the camera {self._name} is gone")
        return found

    def lock(self) -> tuple[dict[str, int], list[str]]:
        """Set nothing: PyAV cannot."""
        if not self._controls:
            return {}, []
        return {}, [f"controls cannot be set through PyAV: {', '.join(self._controls)}"]

    def close(self) -> None:
        """Let the thread end with the next frame."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            with contextlib.suppress(queue.Empty):  # so that it does not wait for room
                while True:
                    self._frames.get_nowait()
            thread.join(_JOIN_S)
