"""What a rig file says, section by section."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from exumi_data.errors import UsageError
from exumi_data.model.base import Identifier, StreamName
from exumi_data.model.description import Embodiment
from exumi_data.release.licence import stated_licence
from exumi_recorders.contract import DriverType

__all__ = ["FORMAT", "VERSION", "About", "Controls", "Device", "Hooks", "Limits", "Rig", "expanded"]

FORMAT: Literal["exumi-rig"] = "exumi-rig"
VERSION = "1.0"

_Text = Annotated[str, Field(pattern=r"^[^\x00]*$")]
_Name = Annotated[str, Field(pattern=r"^[^\x00]+$")]


def _starts_with_a_program(words: list[str]) -> list[str]:
    if not words[0].strip():
        msg = "the first word names a program"
        raise ValueError(msg)
    return words


def _is_licence(text: str) -> str:
    try:
        return stated_licence(text)
    except UsageError as error:
        raise ValueError(error.what) from None  # which the rig file's line is put before


_Command = Annotated[list[_Text], Field(min_length=1), AfterValidator(_starts_with_a_program)]


class _Section(BaseModel):
    """A part of a rig file: what it does not know is a mistake."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class About(_Section):
    """``[rig]``: what is recorded into every episode."""

    name: Identifier
    """Of the device, such as ``exumi``."""
    licence: Annotated[Identifier, AfterValidator(_is_licence)]
    """SPDX expression of what is recorded; ``NOASSERTION`` when that is not decided."""
    serial: _Text | None = None
    hub: _Text | None = None
    """The computer that records, such as ``orange-pi-5``."""
    site: _Text | None = None
    operator: _Text | None = None
    """A pseudonym."""
    data: _Name | None = None
    """Folder of the dataset that episodes go to, from the rig file's own folder."""
    calibration: list[_Name] = []
    """Calibration files, from the rig file's own folder."""


class Controls(_Section):
    """``[controls]``: what starts and stops an episode besides the keys."""

    flag: Identifier | None = None
    """The device whose record flag does it, such as the headset's."""
    world_frame: Identifier | None = None
    """The device that has to send a world frame before an episode can start."""
    reasons: Annotated[
        list[Annotated[str, Field(min_length=1, max_length=200, pattern=r"\D")]],
        Field(max_length=9),
    ] = ["it failed", "tracking was lost", "something else was touched", "the gel slipped"]
    """Why episodes are discarded: the keys 1 to 9 say it after a discard."""


class Limits(_Section):
    """``[limits]``: of the disk, of an episode, and of rates."""

    reserve_mb: Annotated[int, Field(ge=1, le=1 << 20)] = 64
    """A file of this size is kept to close episodes with when the disk is full, MB."""
    least_minutes: Annotated[float, Field(ge=0)] = 2.0
    """No new episode starts with disk for less than this, minutes."""
    longest_minutes: Annotated[float, Field(gt=0)] = 60.0
    """An episode ends by itself after this, minutes."""
    least_rate: Annotated[float, Field(gt=0, le=1)] = 0.8
    """Of a stream's nominal rate: below this share, ``exumi rig check`` fails."""
    queue_mb: Annotated[int, Field(ge=1, le=1 << 16)] = 64
    """What may wait for the disk, all streams together, MB."""


class Hooks(_Section):
    """``[hooks]``: programs to start when something happens, as lists of words: beeps and LEDs."""

    ready: _Command | None = None
    start: _Command | None = None
    stop: _Command | None = None
    discard: _Command | None = None
    problem: _Command | None = None


@dataclass(frozen=True, slots=True)
class Device:
    """A device of a rig.

    Attributes
    ----------
    name : str
        As in ``[devices.NAME]``.
    driver : DriverType
    options : pydantic.BaseModel
        Of the driver.
    streams : mapping of str to str
        Names of streams by name of the driver's port; ports that are not named are not recorded.
    """

    name: str
    driver: DriverType
    options: BaseModel
    streams: Mapping[str, StreamName]


@dataclass(frozen=True, slots=True)
class Rig:
    """A rig file, read and checked.

    Attributes
    ----------
    path : pathlib.Path or None
        The file; None for the simulated rig.
    about : About
    embodiment : Embodiment or None
    controls : Controls
    limits : Limits
    hooks : Hooks
    devices : tuple of Device
        In the order of the file.
    """

    path: Path | None
    about: About
    embodiment: Embodiment | None
    controls: Controls
    limits: Limits
    hooks: Hooks
    devices: tuple[Device, ...]

    @property
    def stream_names(self) -> tuple[str, ...]:
        """The names of all streams, in the order of the file."""
        return tuple(name for device in self.devices for name in device.streams.values())

    def beside(self, name: str) -> Path:
        """Return a path that the rig file gives, from the file's own folder."""
        folder = Path() if self.path is None else self.path.parent
        return folder / expanded(name)


def expanded(name: str) -> Path:
    """Return a path with its ``~`` replaced by the folder of the user; one of nobody stays.

    Parameters
    ----------
    name : str
    """
    try:
        return Path(name).expanduser()
    except RuntimeError:
        return Path(name)
