"""Simulated devices behind the sockets that ``shim.c`` connects device files to."""

import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

__all__ = ["served_bus", "served_transfers"]

_PACKET = 512


def served_bus(bus: Any) -> Callable[[], Any]:
    """Serve a simulated I2C bus; return what opens it by smbus2's own calls.

    Parameters
    ----------
    bus : SimulatedBus
    """
    from smbus2 import SMBus

    def answer(peer: socket.socket) -> None:
        with peer:
            while packet := peer.recv(_PACKET):
                written = packet[1]
                try:
                    given = bus.transfer(packet[0], packet[2 : 2 + written], packet[2 + written])
                except OSError as error:
                    peer.send(bytes([error.errno or 0]))
                else:
                    peer.send(b"\0" + given)
        bus.close()

    def open_bus() -> Any:
        with _listening("EXUMI_I2C_SHIM") as listener:
            opened = SMBus(7)
            peer, _ = listener.accept()
        threading.Thread(target=answer, args=(peer,), daemon=True).start()
        return opened

    return open_bus


@contextmanager
def served_transfers(transfers: Iterator[bytes]) -> Iterator[None]:
    """Serve a USB device that sends some transfers to each who opens it, and then is gone."""

    def run(listener: socket.socket) -> None:
        while True:
            try:
                peer, _ = listener.accept()
            except OSError:
                return  # closed: served long enough
            with peer:
                for data in transfers:
                    try:
                        peer.send(data)
                    except OSError:
                        break

    with _listening("EXUMI_USB_SHIM") as listener:
        threading.Thread(target=run, args=(listener,), daemon=True).start()
        yield
        listener.shutdown(socket.SHUT_RDWR)


@contextmanager
def _listening(variable: str) -> Iterator[socket.socket]:
    path = Path(os.environ[variable])
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        listener.listen()
        try:
            yield listener
        finally:
            path.unlink()
