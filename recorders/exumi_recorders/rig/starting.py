"""``exumi rig init``: rig files to begin with, and the devices that are plugged in."""

import os
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from exumi_data.errors import UsageError
from exumi_data.store.files import write_atomic
from exumi_recorders.drivers.video_lookup import FoundCamera, list_cameras

__all__ = ["TEMPLATES", "PresentDevices", "present_devices", "template", "write_template"]

TEMPLATES = ("exumi", "tmi", "simulated")
"""Rig files to begin with, by the device they are for."""

_SUFFIX = ".toml"
_USB_SERIAL = ("dev/serial/by-id/*",)
_OTHER_SERIAL = ("dev/ttyUSB*", "dev/ttyACM*")


@dataclass(frozen=True, slots=True)
class PresentDevices:
    """What is plugged in.

    Attributes
    ----------
    cameras : tuple of FoundCamera
    i2c_buses : tuple of str
        Paths such as ``/dev/i2c-1``.
    serial_ports : tuple of str
        By their stable names, where they have one.
    tac02 : tuple of str
        Sides of which a TAC-02 is plugged in.
    """

    cameras: tuple[FoundCamera, ...] = ()
    i2c_buses: tuple[str, ...] = ()
    serial_ports: tuple[str, ...] = ()
    tac02: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """Say it for people, one device a line."""
        return [
            *(f"camera       {camera}" for camera in self.cameras),
            *(f"I2C bus      {bus}" for bus in self.i2c_buses),
            *(f"serial port  {port}" for port in self.serial_ports),
            *(f"TAC-02       {side}" for side in self.tac02),
        ]


def template(name: str) -> str:
    """Return the text of a rig file to begin with.

    Parameters
    ----------
    name : str
        One of `TEMPLATES`.

    Raises
    ------
    UsageError
        There is none of that name.
    """
    if name not in TEMPLATES:
        raise UsageError(f"no rig file for {name!r}", fix=f"There are: {', '.join(TEMPLATES)}.")
    folder = resources.files("exumi_recorders.rig") / "templates"
    return (folder / f"{name}{_SUFFIX}").read_text(encoding="utf-8")


def write_template(name: str, path: Path, *, force: bool = False) -> Path:
    """Write a rig file to begin with.

    Parameters
    ----------
    name : str
        One of `TEMPLATES`.
    path : pathlib.Path
        Ends in ``.toml``.
    force : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    UsageError
        There is no such template, the name is none of a TOML file, or a file is there already.
    """
    text = template(name)
    if path.suffix != _SUFFIX:
        raise UsageError("a rig file of this kind is TOML", where=path, fix=f"Name it *{_SUFFIX}.")
    if path.is_dir() or (os.path.lexists(path) and not force):
        raise UsageError(
            "it is there already", where=path, fix="Name another file, or say --force."
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, text.encode())
    return path


def present_devices(root: Path = Path("/")) -> PresentDevices:
    """List what is plugged in, without opening anything.

    Parameters
    ----------
    root : pathlib.Path
        Where ``dev`` and ``sys`` are.
    """
    usb = root / "sys" / "bus" / "usb" / "devices"
    return PresentDevices(
        cameras=tuple(list_cameras(root / "sys")),
        i2c_buses=_found(root, "dev/i2c-*"),
        serial_ports=_found(root, *_USB_SERIAL) or _found(root, *_OTHER_SERIAL),
        tac02=_tac02_sides(usb),
    )


def _found(root: Path, *patterns: str) -> tuple[str, ...]:
    paths = [path for pattern in patterns for path in root.glob(pattern)]
    return tuple(f"/{path.relative_to(root).as_posix()}" for path in sorted(paths))


def _tac02_sides(usb: Path) -> tuple[str, ...]:
    try:
        from exumi_recorders.drivers.tac02 import PRODUCTS, VENDOR
        from exumi_recorders.drivers.usb_endpoint import find_devices
    except ModuleNotFoundError:  # fcntl: only Linux has it
        return ()
    return tuple(
        side for side, product in PRODUCTS.items() if find_devices(VENDOR, product, sysfs=usb)
    )
