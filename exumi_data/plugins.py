"""What other packages add, by entry points."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from exumi_data.errors import UsageError

__all__ = ["Plugin", "load_plugins", "refuse_twice"]


@dataclass(frozen=True, slots=True)
class Plugin:
    """Something that another package adds.

    Attributes
    ----------
    group : str
        Entry-point group, such as ``exumi.checks``.
    name : str
        Name of the entry point.
    distribution : str
        The package, as pip knows it.
    version : str
        Of the package.
    value : object
        What the entry point leads to.
    """

    group: str
    name: str
    distribution: str
    version: str
    value: Any

    @property
    def origin(self) -> str:
        """The package and its version, for messages."""
        return f"{self.distribution} {self.version}".strip()


def load_plugins(group: str) -> tuple[Plugin, ...]:
    """Load everything that other packages add to a group, in order of their names.

    Parameters
    ----------
    group : str

    Raises
    ------
    UsageError
        One cannot be loaded, or two have the same name.
    """
    points = sorted(entry_points(group=group), key=lambda point: (point.name, point.value))
    found: dict[str, Plugin] = {}
    for point in points:
        plugin = _load(point)
        if point.name in found:
            refuse_twice(f"{group} {point.name!r}", found[point.name].origin, plugin.origin)
        found[point.name] = plugin
    return tuple(found.values())


def _load(point: EntryPoint) -> Plugin:
    package = point.dist.name if point.dist else point.value
    version = point.dist.version if point.dist else ""
    try:
        value = point.load()
    except Exception as error:  # importing runs a stranger's code: it may raise anything
        raise UsageError(
            f"the plugin {point.name!r} ({point.group}) of {package} {version} cannot be loaded: "
            f"{type(error).__name__}: {error}",
            fix=f"Upgrade {package}, or remove it with: pip uninstall {package}",
        ) from error
    return Plugin(point.group, point.name, package, version, value)


def refuse_twice(what: str, first: str, second: str) -> None:
    """Refuse two packages that add the same thing.

    Parameters
    ----------
    what : str
        What both add.
    first, second : str
        The packages.

    Raises
    ------
    UsageError
        Always.
    """
    raise UsageError(
        f"{what} is registered twice: by {first} and by {second}",
        fix="Remove one of the two packages.",
    )
