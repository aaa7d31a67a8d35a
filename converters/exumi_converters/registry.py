"""The formats that can be converted: ours, and those that other packages add.

Another package adds one with an entry point of the group ``exumi.converters`` that names an object
as described by `exumi_converters.converter.Converter`.
"""

from exumi_converters.clips import ClipsConverter
from exumi_converters.converter import Converter
from exumi_converters.octopi import OctopiConverter
from exumi_data.errors import UsageError
from exumi_data.plugins import Plugin, load_plugins, refuse_twice

__all__ = ["ENTRY_POINTS", "FORMATS", "converters", "find_converter"]

ENTRY_POINTS = "exumi.converters"

_OWN: tuple[Converter, ...] = (ClipsConverter(), OctopiConverter())
FORMATS: tuple[str, ...] = tuple(converter.name for converter in _OWN)
"""Names of the formats that this package converts."""


def converters() -> dict[str, Converter]:
    """Return all converters by name: our own, and those of other packages.

    Raises
    ------
    UsageError
        Two have the same name.
    """
    found = {converter.name: converter for converter in _OWN}
    for plugin in load_plugins(ENTRY_POINTS):
        if plugin.name in found:
            refuse_twice(f"the format {plugin.name!r}", "exumi-data", plugin.origin)
        found[plugin.name] = _checked(plugin)
    return found


def _checked(plugin: Plugin) -> Converter:
    if getattr(plugin.value, "name", None) != plugin.name:
        raise UsageError(
            f"the converter that {plugin.distribution} registers as {plugin.name!r} does not bear "
            "that name",
            fix="Tell the authors of that package.",
        )
    converter: Converter = plugin.value
    return converter


def find_converter(name: str) -> Converter:
    """Return a converter by name.

    Raises
    ------
    UsageError
        There is none.
    """
    # Worker processes ask for each episode: looking up what is installed is slow.
    for converter in _OWN:
        if converter.name == name:
            return converter
    known = converters()
    if name not in known:
        raise UsageError(f"Invalid format ({name}). Supported values are {', '.join(known)}")
    return known[name]
