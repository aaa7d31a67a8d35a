"""Serving frames over a UNIX socket as they come due: what all framed devices do."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from exumi_data.time import NS_PER_S
from exumi_recorders.drivers.socket_camera import pack_header
from exumi_recorders.simulated.schedule import FramedSetup

__all__ = ["serve_frames"]

Content: TypeAlias = Callable[[int], bytes]

_SEND_BUFFER = 1 << 20
_LOOK_S = 0.05
_SEQUENCES = 1 << 32


def serve_frames(setup: FramedSetup, content: Content, stop: threading.Event | None = None) -> None:
    """Be a device until `stop`: one reader at a time, unplugged when the setup says so.

    Parameters
    ----------
    setup : FramedSetup
    content : callable
        Gives the bytes of frame k.
    stop : threading.Event, optional
        Ends it; without, it goes on for ever.
    """
    stop = stop or threading.Event()
    try:
        while not stop.is_set():
            end_s = setup.absence_end_s(time.monotonic_ns())
            if end_s is not None:
                stop.wait(min(_LOOK_S, max(0.0, end_s - _now_s(setup))))
                continue
            with _listening(setup.socket) as listener:
                _until_unplugged(setup, content, listener, stop)
            Path(setup.socket).unlink(missing_ok=True)
    finally:
        Path(setup.socket).unlink(missing_ok=True)


def _now_s(setup: FramedSetup) -> float:
    return (time.monotonic_ns() - setup.epoch_ns) / NS_PER_S


def _listening(path: str) -> socket.socket:
    Path(path).unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    # The path appears when it is listened to: one that is only bound refuses connections.
    unheard = f"{path}~"
    Path(unheard).unlink(missing_ok=True)
    listener.bind(unheard)
    listener.listen(1)
    Path(unheard).rename(path)
    listener.settimeout(_LOOK_S)
    return listener


def _until_unplugged(
    setup: FramedSetup,
    content: Content,
    listener: socket.socket,
    stop: threading.Event,
) -> None:
    while not stop.is_set() and setup.absence_end_s(time.monotonic_ns()) is None:
        try:
            connection, _ = listener.accept()
        except TimeoutError:
            continue
        with connection, contextlib.suppress(ConnectionError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            _stream(setup, content, connection, stop)


def _stream(
    setup: FramedSetup,
    content: Content,
    connection: socket.socket,
    stop: threading.Event,
) -> None:
    """Send frames when they are due; ConnectionError when the reader is gone."""
    stop.wait(setup.slow_start_s)
    first = k = setup.first_frame(time.monotonic_ns())
    patience_ns = int(setup.buffers * setup.period)
    while not stop.is_set():
        fate = setup.fate(k)
        stamp_ns = setup.stamp_ns(k)
        due_ns = stamp_ns + setup.hand_out_delay_ns
        if time.monotonic_ns() - due_ns >= patience_ns:
            # So late that the next ones are too: without them, it is in time again.
            k = max(k + 1, setup.first_frame(time.monotonic_ns()))
            continue
        # Made before it is due: the time that takes is not the device's latency.
        file = content(k) if fate != "dropped" else b""
        wait_ns = due_ns - time.monotonic_ns()
        if wait_ns > 0:
            stop.wait(wait_ns / NS_PER_S)
        if setup.absence_end_s(time.monotonic_ns()) is not None:
            return
        # Of a reader that does not keep up, and of making them that does not, frames are lost.
        if file and time.monotonic_ns() - due_ns < patience_ns:
            file = file[: len(file) * 2 // 3] if fate == "cut" else file
            sequence = (k - first) % _SEQUENCES
            header = pack_header(stamp_ns, sequence, len(file), damaged=fate == "damaged")
            _send(connection, header, file)
        k += 1


def _send(connection: socket.socket, header: bytes, file: bytes) -> None:
    sent = connection.sendmsg([header, file])
    if sent < len(header):
        connection.sendall(header[sent:])
        sent = len(header)
    if sent < len(header) + len(file):
        connection.sendall(memoryview(file)[sent - len(header) :])
