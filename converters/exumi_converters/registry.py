"""The formats that can be converted: ours, and those that other packages add.

Another package adds one with an entry point of the group ``exumi.converters`` that names an object
as described by `exumi_converters.converter.Converter`.
"""

from importlib.metadata import EntryPoint, entry_points

from exumi_converters.clips import ClipsConverter
from exumi_converters.converter import Converter
from exumi_converters.octopi import OctopiConverter
from exumi_data.errors import UsageError

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
    origin = dict.fromkeys(found, "exumi-data")
    for point in entry_points(group=ENTRY_POINTS):
        package = point.dist.name if point.dist else point.value
        if point.name in found:
            raise UsageError(
                f"the format {point.name!r} is registered twice: by {origin[point.name]} and by "
                f"{package}",
                fix="Remove one of the two packages.",
            )
        found[point.name] = _load(point, package)
        origin[point.name] = package
    return found


def _load(point: EntryPoint, package: str) -> Converter:
    converter = point.load()
    if getattr(converter, "name", None) != point.name:
        raise UsageError(
            f"the converter that {package} registers as {point.name!r} does not bear that name",
            fix="Tell the authors of that package.",
        )
    loaded: Converter = converter
    return loaded


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
