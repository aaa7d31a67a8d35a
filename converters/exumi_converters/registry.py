"""The formats that are read and written: ours, and those that other packages add.

Another package adds one with an entry point of the group ``exumi.converters`` that names an object
as described by `exumi_converters.converter.Converter`; one that is written is of the group
``exumi.exporters`` and as described by `exumi_converters.exporter.Exporter`.
"""

from collections.abc import Mapping
from typing import TypeVar

from exumi_converters.clips import ClipsConverter
from exumi_converters.converter import Converter
from exumi_converters.exporter import Exporter
from exumi_converters.octopi import OctopiConverter
from exumi_converters.umi import UmiConverter, UmiExporter
from exumi_data.errors import UsageError
from exumi_data.plugins import Plugin, load_plugins, refuse_twice

__all__ = [
    "ENTRY_POINTS",
    "EXPORTERS",
    "EXPORT_ENTRY_POINTS",
    "FORMATS",
    "converters",
    "exporters",
    "find_converter",
    "find_exporter",
]

ENTRY_POINTS = "exumi.converters"
EXPORT_ENTRY_POINTS = "exumi.exporters"

_OWN: Mapping[str, Converter] = {
    converter.name: converter for converter in (ClipsConverter(), OctopiConverter(), UmiConverter())
}
_OWN_EXPORTERS: Mapping[str, Exporter] = {exporter.name: exporter for exporter in (UmiExporter(),)}
FORMATS: tuple[str, ...] = tuple(_OWN)
"""Names of the formats that this package reads."""
EXPORTERS: tuple[str, ...] = tuple(_OWN_EXPORTERS)
"""Names of the formats that this package writes."""

Named = TypeVar("Named", Converter, Exporter)


def converters() -> dict[str, Converter]:
    """Return all converters by name: our own, and those of other packages.

    Raises
    ------
    UsageError
        Two have the same name.
    """
    return _with_plugins(_OWN, ENTRY_POINTS, "converter")


def exporters() -> dict[str, Exporter]:
    """Return all exporters by name: our own, and those of other packages.

    Raises
    ------
    UsageError
        Two have the same name.
    """
    return _with_plugins(_OWN_EXPORTERS, EXPORT_ENTRY_POINTS, "exporter")


def _with_plugins(own: Mapping[str, Named], group: str, what: str) -> dict[str, Named]:
    found = dict(own)
    for plugin in load_plugins(group):
        if plugin.name in found:
            refuse_twice(f"the format {plugin.name!r}", "exumi-data", plugin.origin)
        _check_name(plugin, what)
        found[plugin.name] = plugin.value
    return found


def _check_name(plugin: Plugin, what: str) -> None:
    if getattr(plugin.value, "name", None) != plugin.name:
        raise UsageError(
            f"the {what} that {plugin.distribution} registers as {plugin.name!r} does not bear "
            "that name",
            fix="Tell the authors of that package.",
        )


def find_converter(name: str) -> Converter:
    """Return a converter by name.

    Raises
    ------
    UsageError
        There is none.
    """
    # Worker processes ask for each episode: looking up what is installed is slow.
    return _OWN[name] if name in _OWN else _known(converters(), name)


def find_exporter(name: str) -> Exporter:
    """Return an exporter by name.

    Raises
    ------
    UsageError
        There is none.
    """
    return _OWN_EXPORTERS[name] if name in _OWN_EXPORTERS else _known(exporters(), name)


def _known(known: Mapping[str, Named], name: str) -> Named:
    if name not in known:
        raise UsageError(f"Invalid format ({name}). Supported values are {', '.join(known)}")
    return known[name]
