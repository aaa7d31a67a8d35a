"""Cameras behind a UNIX socket: frames with stamp and sequence, as the simulated camera sends them.

Each frame is a header and a file: 4 bytes ``EXF1``, flags (uint32; bit 0: the data may be damaged),
stamp (int64, ns of CLOCK_MONOTONIC), sequence (uint64), length (uint32), all little-endian, then
the JPEG.
"""

import contextlib
import select
import socket
import struct
from typing import Final

from exumi_data.model.clock import StampPoint
from exumi_recorders.contract import DeviceError, DeviceLostError
from exumi_recorders.drivers.camera import Frame, Shape

__all__ = ["HEADER", "MAGIC", "SocketSource", "pack_header"]

HEADER: Final = struct.Struct("<4sIqQI")
MAGIC: Final = b"EXF1"
DAMAGED: Final = 1

_MOST_BYTES = 64 << 20
_STALLED = struct.pack("ll", 2, 0)  # seconds, microseconds: a frame that began has to end
_MOST_FRAMES = 16


def pack_header(stamp_ns: int, sequence: int, length: int, *, damaged: bool = False) -> bytes:
    """Return the header of a frame."""
    return HEADER.pack(MAGIC, DAMAGED if damaged else 0, stamp_ns, sequence, length)


class SocketSource:
    """Frames from a UNIX socket.

    Parameters
    ----------
    path : str
        Of the socket.
    """

    stamp_point: StampPoint = "buffer_soe"
    modulus: int | None = 1 << 32
    serial: str | None = None
    lossy: str | None = None

    def __init__(self, path: str) -> None:
        self._path = path
        self._socket: socket.socket | None = None
        self._spoilt = False

    def open(self, shape: Shape) -> None:
        """Connect.

        Raises
        ------
        DeviceError
            Nobody serves it.
        """
        self._spoilt = False
        self._socket = connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _STALLED)
        try:
            connection.connect(self._path)
        except OSError as error:
            raise DeviceError(
                f"no camera serves the socket {self._path} ({error.strerror or error})"
            ) from None

    def read(self, timeout_s: float) -> list[Frame]:
        """Return the frames that have come.

        Raises
        ------
        DeviceLostError
            The other side is gone, or sends something else.
        """
        connection = self._socket
        if connection is None:
            raise DeviceError(f"the camera at {self._path} is not open")
        if self._spoilt:
            raise self._no_frame()
        poller = select.poll()
        poller.register(connection, select.POLLIN)
        frames: list[Frame] = []
        wait_ms = timeout_s * 1e3
        while len(frames) < _MOST_FRAMES and poller.poll(wait_ms):
            try:
                frames.append(self._frame(connection))
            except DeviceLostError:
                if frames:
                    break  # these came before; the loss is found again with the next call
                raise
            wait_ms = 0.0
        return frames

    def _frame(self, connection: socket.socket) -> Frame:
        magic, flags, stamp_ns, sequence, length = HEADER.unpack(
            self._whole(connection, HEADER.size)
        )
        # Where the next frame begins cannot be known any more.
        self._spoilt = self._spoilt or magic != MAGIC or length > _MOST_BYTES
        if self._spoilt:
            raise self._no_frame()
        data = self._whole(connection, length)
        fault = "error" if flags & DAMAGED else None
        return Frame(data, stamp_ns, sequence % (1 << 32), fault)

    def _no_frame(self) -> DeviceLostError:
        return DeviceLostError(f"what comes from {self._path} is no frame")

    def _whole(self, connection: socket.socket, length: int) -> bytes:
        try:
            data = connection.recv(length, socket.MSG_WAITALL) if length else b""
        except OSError as error:
            raise DeviceLostError(
                f"the camera at {self._path} is gone ({error.strerror or error})"
            ) from None
        if len(data) < length:
            raise DeviceLostError(f"the camera at {self._path} is gone")
        return data

    def lock(self) -> tuple[dict[str, int], list[str]]:
        """Set nothing: there are no controls."""
        return {}, []

    def close(self) -> None:
        """Disconnect."""
        connection, self._socket = self._socket, None
        if connection is not None:
            with contextlib.suppress(OSError):
                connection.close()
