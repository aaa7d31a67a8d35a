"""The registry: names that mean the same everywhere."""

import re
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from exumi_data.standard.toml_data import read_toml

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = [
    "ArraySpec",
    "Encoding",
    "Flag",
    "Kind",
    "SensorModel",
    "StampPoint",
    "Unit",
    "common_arrays",
    "derived_arrays",
    "derived_name_fault",
    "encodings",
    "flags",
    "kinds",
    "sensors",
    "stamp_points",
    "units",
]

_DERIVED_OF_THIRD_PARTY = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*__[a-z0-9][a-z0-9_]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class ArraySpec:
    """An array that the standard names.

    Attributes
    ----------
    name : str
    dtype : tuple of str
        The data types it may have, by their Zarr names.
    shape : tuple of int or str
        A size, or a word for one: ``N`` samples, ``N+1``, ``F+1``, ``B`` bytes, ``S`` sound
        samples, ``K`` any number, a field of the stream's metadata (``height`` ... ``columns``),
        or ``...``.
    dimensions : tuple of str
        Names of the first axes.
    unit : str or None
        None where the metadata states it.
    required : bool
    kinds : tuple of str
        Of a derived array: the kinds of streams that it is computed from.
    text : str
    """

    name: str
    dtype: tuple[str, ...]
    shape: tuple[int | str, ...]
    dimensions: tuple[str, ...]
    text: str
    unit: str | None = None
    required: bool = False
    kinds: tuple[str, ...] = ()

    @property
    def per_sample(self) -> bool:
        """Whether it has one row a sample."""
        return self.shape[0] == "N"


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of stream."""

    name: str
    status: Literal["core", "reserved"]
    text: str
    images: bool = False
    arrays: "Mapping[str, ArraySpec]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoding:
    """A way to store frames."""

    name: str
    text: str
    arrays: "Mapping[str, ArraySpec]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """A unit; `si` is the factor to the SI unit, `ns` that to nanoseconds."""

    name: str
    quantity: str
    text: str
    si: float | None = None
    ns: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Flag:
    """A bit of ``flags``."""

    bit: int
    name: str
    text: str

    @property
    def mask(self) -> int:
        """The flag as a number."""
        return 1 << self.bit


@dataclass(frozen=True, slots=True, kw_only=True)
class StampPoint:
    """Where on its way a sample got its time."""

    name: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorModel:
    """A sensor by its registered name.

    Attributes
    ----------
    name, maker, kind, text : str
    light : {"coloured", "white"} or None
        Of a visuo-tactile sensor: lights of several colours from several sides, or white and even.
    """

    name: str
    maker: str
    kind: str
    text: str
    light: Literal["coloured", "white"] | None = None


def _arrays(entries: list[dict[str, Any]]) -> "Mapping[str, ArraySpec]":
    found = {}
    for entry in entries:
        fields: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()
        }
        found[entry["name"]] = ArraySpec(**fields)
    return MappingProxyType(found)


@cache
def common_arrays() -> "Mapping[str, ArraySpec]":
    """Return the arrays that a stream of any kind may have, by name."""
    return _arrays(read_toml("kinds.toml")["common"])


@cache
def derived_arrays() -> "Mapping[str, ArraySpec]":
    """Return the derived arrays that the standard names."""
    return _arrays(read_toml("kinds.toml")["derived"])


def derived_name_fault(name: str, kind: str | None) -> str | None:
    """Say why a derived array cannot have a name, in a few words; None where it can (DRV-007).

    Parameters
    ----------
    name : str
        ``<name>`` of ``derived/<stream>/<name>``.
    kind : str or None
        The kind of the stream that it is computed from; None where it is not known.
    """
    if _DERIVED_OF_THIRD_PARTY.fullmatch(name):
        return None
    spec = derived_arrays().get(name)
    if spec is None:
        return f"expected {', '.join(derived_arrays())} or <vendor>__<name>"
    if kind is None or kind in spec.kinds:
        return None
    return f"which is computed from streams of the kind {' or '.join(spec.kinds)}"


@cache
def kinds() -> "Mapping[str, Kind]":
    """Return the kinds of streams, by name. Arrays of images depend on the encoding."""
    found = {}
    for entry in read_toml("kinds.toml")["kind"]:
        arrays = _arrays(entry.pop("array", []))
        found[entry["name"]] = Kind(**entry, arrays=arrays)
    return MappingProxyType(found)


@cache
def encodings() -> "Mapping[str, Encoding]":
    """Return the encodings of images, by name."""
    found = {}
    for entry in read_toml("kinds.toml")["encoding"]:
        arrays = _arrays(entry.pop("array"))
        found[entry["name"]] = Encoding(**entry, arrays=arrays)
    return MappingProxyType(found)


@cache
def units() -> "Mapping[str, Unit]":
    """Return the units, by name."""
    entries = read_toml("units.toml")["unit"]
    return MappingProxyType({entry["name"]: Unit(**entry) for entry in entries})


@cache
def flags() -> "Mapping[str, Flag]":
    """Return the bits of ``flags``, by name."""
    entries = read_toml("flags.toml")["flag"]
    return MappingProxyType({entry["name"]: Flag(**entry) for entry in entries})


@cache
def stamp_points() -> "Mapping[str, StampPoint]":
    """Return the stamp points, by name."""
    entries = read_toml("clocks.toml")["stamp"]
    return MappingProxyType({entry["name"]: StampPoint(**entry) for entry in entries})


@cache
def sensors() -> "Mapping[str, SensorModel]":
    """Return the registered sensor models, by name."""
    entries = read_toml("sensors.toml")["sensor"]
    return MappingProxyType({entry["name"]: SensorModel(**entry) for entry in entries})
