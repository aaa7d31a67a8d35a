"""Reading a USB endpoint through Linux's ``/dev/bus/usb``, without any library.

For devices that have no driver of their own in the kernel, or one that hides where a transfer ends.
"""

import ctypes
import errno
import fcntl
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from exumi_recorders.contract import DeviceError, DeviceLostError

__all__ = ["UsbDevice", "UsbEndpoint", "find_devices"]

_SYSFS = Path("/sys/bus/usb/devices")
_NODES = Path("/dev/bus/usb")
_MOST_BYTES = 512
_GONE = (errno.ENODEV, errno.ESHUTDOWN, errno.EPROTO, errno.ENOENT)


class _Bulk(ctypes.Structure):
    _fields_ = (
        ("endpoint", ctypes.c_uint),
        ("length", ctypes.c_uint),
        ("timeout_ms", ctypes.c_uint),
        ("data", ctypes.c_void_p),
    )


class _Command(ctypes.Structure):
    _fields_ = (("interface", ctypes.c_int), ("code", ctypes.c_int), ("data", ctypes.c_void_p))


class _Claim(ctypes.Structure):
    _fields_ = (
        ("interface", ctypes.c_uint),
        ("flags", ctypes.c_uint),
        ("driver", ctypes.c_char * 256),
    )


def _request(direction: int, number: int, size: int) -> int:
    # linux/ioctl.h: direction, size, group 'U', number.
    return direction << 30 | size << 16 | ord("U") << 8 | number


_BULK = _request(3, 2, ctypes.sizeof(_Bulk))
_RELEASE = _request(2, 16, ctypes.sizeof(ctypes.c_uint))
_COMMAND = _request(3, 18, ctypes.sizeof(_Command))
_CONNECT = _request(0, 23, 0)
_DISCONNECT_CLAIM = _request(2, 27, ctypes.sizeof(_Claim))


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A device that is plugged in.

    Attributes
    ----------
    node : pathlib.Path
        Its file below ``/dev/bus/usb``.
    serial : str or None
    interfaces : mapping of int to int
        From the address of an input endpoint to the number of its interface.
    """

    node: Path
    serial: str | None
    interfaces: dict[int, int]


def find_devices(vendor: int, product: int, *, sysfs: Path = _SYSFS) -> list[UsbDevice]:
    """Return the devices of a vendor and product that are plugged in.

    Parameters
    ----------
    vendor, product : int
    sysfs : pathlib.Path, optional
        Where the kernel lists devices.
    """
    found = []
    for folder in sorted(sysfs.glob("*")):
        if (
            _number(folder / "idVendor", 16) != vendor
            or _number(folder / "idProduct", 16) != product
        ):
            continue
        bus, device = _number(folder / "busnum", 10), _number(folder / "devnum", 10)
        if bus is None or device is None:
            continue
        interfaces = {}
        for endpoint in folder.glob(f"{folder.name}:*/ep_*"):
            interface = _number(endpoint.parent / "bInterfaceNumber", 16)
            if interface is not None:
                interfaces[int(endpoint.name.removeprefix("ep_"), 16)] = interface
        found.append(
            UsbDevice(_NODES / f"{bus:03}" / f"{device:03}", _text(folder / "serial"), interfaces)
        )
    return found


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None


def _number(path: Path, base: int) -> int | None:
    text = _text(path)
    return None if text is None else int(text, base)


class UsbEndpoint:
    """An input endpoint, taken from the kernel's driver while it is open.

    Parameters
    ----------
    device : UsbDevice
    endpoint : int
        Its address, such as 0x81.

    Raises
    ------
    DeviceError
        The device has no such endpoint, is in use, or may not be used.
    """

    def __init__(self, device: UsbDevice, endpoint: int) -> None:
        interface = device.interfaces.get(endpoint)
        if interface is None:
            raise DeviceError(f"the device has no endpoint {endpoint:#04x}", where=device.node)
        self._where, self._endpoint, self._interface = device.node, endpoint, interface
        self._buffer = ctypes.create_string_buffer(_MOST_BYTES)
        try:
            self._file = os.open(device.node, os.O_RDWR | os.O_CLOEXEC)
        except PermissionError:
            fix = (
                "Let users have it by a udev rule: "
                'SUBSYSTEMS=="usb", ATTRS{idVendor}=="2fe3", GROUP="dialout", MODE="0660"'
            )
            raise DeviceError("the device may not be used", where=device.node, fix=fix) from None
        except OSError as error:
            raise DeviceError(f"cannot be opened ({error.strerror})", where=device.node) from None
        try:
            fcntl.ioctl(self._file, _DISCONNECT_CLAIM, _Claim(interface=interface))
        except OSError as error:
            os.close(self._file)
            raise DeviceError(
                f"the device cannot be claimed ({error.strerror})",
                where=device.node,
                fix="End other programs that read it.",
            ) from None

    def receive(self, timeout_s: float) -> bytes:
        """Return the bytes of one transfer; nothing after the timeout.

        Parameters
        ----------
        timeout_s : float
            At least a millisecond is waited: none would be for ever.

        Raises
        ------
        DeviceLostError
            The device is gone.
        """
        request = _Bulk(
            endpoint=self._endpoint,
            length=_MOST_BYTES,
            timeout_ms=max(1, int(timeout_s * 1000)),
            data=ctypes.addressof(self._buffer),
        )
        try:
            count = fcntl.ioctl(self._file, _BULK, request)
        except TimeoutError:
            return b""
        except OSError as error:
            if error.errno in _GONE:
                raise DeviceLostError(
                    f"the USB device is gone ({error.strerror})",
                    where=self._where,
                    fix="Plug it in again.",
                ) from error
            raise DeviceError(f"cannot be read ({error.strerror})", where=self._where) from error
        return self._buffer.raw[:count]

    def close(self) -> None:
        """Give it back to the kernel's driver; also when the device is gone."""
        for code, argument in (
            (_RELEASE, ctypes.c_uint(self._interface)),
            (_COMMAND, _Command(interface=self._interface, code=_CONNECT)),
        ):
            with suppress(OSError):  # it is gone, or the kernel has no driver for it
                fcntl.ioctl(self._file, code, argument)
        os.close(self._file)
