"""Which ``/dev/videoN`` a camera is: by its USB id, so that left and right do not swap."""

import re
from dataclasses import dataclass
from pathlib import Path

from exumi_recorders.contract import DeviceError

__all__ = ["FoundCamera", "find_camera", "list_cameras"]

_USB_ID = re.compile(r"(?P<vendor>[0-9a-fA-F]{4}):(?P<product>[0-9a-fA-F]{4})(:(?P<serial>\S+))?")
_MOST_PARENTS = 8


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that the kernel lists.

    Attributes
    ----------
    path : str
        Such as ``/dev/video0``.
    name : str
        As the camera calls itself.
    usb_id : str or None
        ``vendor:product``; None of what is on no USB.
    serial : str or None
    port : str or None
        Where it is plugged in, such as ``1-1.2``.
    """

    path: str
    name: str
    usb_id: str | None = None
    serial: str | None = None
    port: str | None = None

    def __str__(self) -> str:
        serial = f"serial {self.serial}" if self.serial else None
        port = f"port {self.port}" if self.port else None
        known = [item for item in (self.name, self.usb_id, serial, port) if item]
        return f"{self.path} ({', '.join(known)})"


def list_cameras(system: Path = Path("/sys")) -> list[FoundCamera]:
    """List cameras, the first device of each: further ones carry metadata.

    Parameters
    ----------
    system : pathlib.Path
        Where the kernel's ``sysfs`` is.
    """
    found = []
    folder = system / "class" / "video4linux"
    nodes = sorted(folder.glob("video[0-9]*"), key=lambda node: int(node.name[5:]))
    for node in nodes:
        if _read(node / "index") not in (None, "0"):
            continue
        path, name = f"/dev/{node.name}", _read(node / "name") or "camera"
        usb = _usb_device(node / "device")
        if usb is None:
            found.append(FoundCamera(path, name))
            continue
        usb_id = f"{_read(usb / 'idVendor')}:{_read(usb / 'idProduct')}"
        found.append(FoundCamera(path, name, usb_id, _read(usb / "serial"), usb.name))
    return found


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip() or None
    except OSError:
        return None


def _usb_device(interface: Path) -> Path | None:
    """Return the USB device that an interface belongs to: the nearest parent with an id."""
    place = interface.resolve()
    for folder in (place, *place.parents[:_MOST_PARENTS]):
        if (folder / "idVendor").exists():
            return folder
    return None


def find_camera(device: str, system: Path = Path("/sys")) -> FoundCamera:
    """Return the camera that a rig file means.

    Parameters
    ----------
    device : str
        A path (``/dev/video0``, ``/dev/v4l/by-id/...``), or ``vendor:product`` or
        ``vendor:product:serial`` of USB.
    system : pathlib.Path

    Raises
    ------
    DeviceError
        There is none, or more than one.
    """
    cameras = list_cameras(system)
    if device.startswith("/"):
        return _by_path(device, cameras)
    match = _USB_ID.fullmatch(device)
    if match is None:
        raise DeviceError(
            f"{device!r} names no camera",
            fix="Write /dev/video0, a path below /dev/v4l/, or vendor:product:serial of USB.",
        )
    usb_id, serial = f"{match['vendor']}:{match['product']}".lower(), match["serial"]
    fitting = [camera for camera in cameras if camera.usb_id == usb_id]
    fitting = [camera for camera in fitting if serial in (None, camera.serial)]
    there = "; ".join(map(str, cameras)) or "none"
    if not fitting:
        raise DeviceError(f"no camera {device} is plugged in", fix=f"There are: {there}.")
    if len(fitting) > 1:
        raise DeviceError(
            f"{len(fitting)} cameras are {device}: {'; '.join(map(str, fitting))}",
            fix="Add the serial number, or, where they have the same, name the plug: a path below "
            "/dev/v4l/by-path/.",
        )
    return fitting[0]


def _by_path(device: str, cameras: list[FoundCamera]) -> FoundCamera:
    # A link below /dev/v4l leads to the device; its name is what sysfs knows.
    path = Path(device)
    if not path.exists():
        there = "; ".join(map(str, cameras)) or "none"
        raise DeviceError(f"there is no camera {device}", fix=f"There are: {there}.")
    real = str(path.resolve())
    known = [camera for camera in cameras if camera.path == real]
    return known[0] if known else FoundCamera(path=real, name=path.name)
