"""Serial ports: opened by pyserial, read without delay."""

import errno
import os
import select
from contextlib import suppress
from typing import Any

from exumi_data.errors import MissingExtraError
from exumi_recorders.contract import DeviceError, DeviceLostError

__all__ = ["SerialPort"]

_MOST_BYTES = 4096
_FIXES = {
    errno.ENOENT: "Is it plugged in? `ls -l /dev/serial/by-id` lists what is there.",
    errno.EACCES: "Add the user to the group dialout: sudo usermod -aG dialout $USER, "
    "then log in again.",
    errno.EAGAIN: "Another program has it open; `fuser` tells which.",
    errno.EBUSY: "Another program has it open; `fuser` tells which.",
}


class SerialPort:
    """An open serial port, for this program alone; what came before is thrown away.

    Parameters
    ----------
    path : str
        Such as ``/dev/serial/by-id/...`` or ``/dev/ttyACM0``.
    baud : int, optional
        Means nothing where the port is a USB device's own.

    Raises
    ------
    DeviceError
        It is not there, is in use, or may not be used.
    MissingExtraError
        pyserial is not installed.
    """

    def __init__(self, path: str, baud: int = 115200) -> None:
        try:
            from serial import Serial, SerialException
        except ModuleNotFoundError:
            raise MissingExtraError(
                "serial devices need pyserial",
                fix='Install it: pip install "exumi-data[record]"',
            ) from None
        self._path = path
        try:
            self._port: Any = Serial(path, baud, timeout=0, exclusive=True)
        except (SerialException, OSError, ValueError) as error:
            number = getattr(error, "errno", None) or 0
            raise DeviceError(
                f"the serial port cannot be opened ({os.strerror(number) if number else error})",
                where=path,
                fix=_FIXES.get(number),
            ) from None
        self._file: int = self._port.fileno()
        self._poll = select.poll()
        self._poll.register(self._file, select.POLLIN)

    def receive(self, timeout_s: float) -> bytes:
        """Return what has come as soon as something has; nothing after the timeout.

        Parameters
        ----------
        timeout_s : float

        Raises
        ------
        DeviceLostError
            The device is gone.
        """
        try:
            if not self._poll.poll(max(0.0, 1e3 * timeout_s)):
                return b""
            data = os.read(self._file, _MOST_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error.strerror) from error
        if not data:
            raise self._gone("it was closed at the other end")
        return data

    def close(self) -> None:
        """Close it; also when the device is gone."""
        with suppress(OSError):  # it is gone
            self._port.close()

    def _gone(self, why: str | None) -> DeviceLostError:
        return DeviceLostError(
            f"the serial device is gone ({why})", where=self._path, fix="Plug it in again."
        )
