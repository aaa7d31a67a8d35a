"""Drivers by the name that rig files use: those of this package, and those that others add."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from exumi_data.errors import UsageError
from exumi_data.plugins import load_plugins, refuse_twice
from exumi_recorders.contract import DriverType

__all__ = ["DRIVERS", "driver_names", "find_driver"]

DRIVERS = "exumi.drivers"
"""The group of the entry points."""

# Each module has a DriverType named DRIVER, or, where one module has several, as after the colon.
_BUILT_IN: Mapping[str, str] = MappingProxyType(
    {
        "9dtact": "exumi_recorders.drivers.camera_profiles:NINE_DTACT",
        "as5600": "exumi_recorders.drivers.as5600",
        "alsa": "exumi_recorders.drivers.alsa",
        "digit": "exumi_recorders.drivers.camera_profiles:DIGIT",
        "gelsight-mini": "exumi_recorders.drivers.camera_profiles:GELSIGHT_MINI",
        "hdmi": "exumi_recorders.drivers.camera_profiles:HDMI",
        "line": "exumi_recorders.drivers.line",
        "quest": "exumi_recorders.drivers.quest",
        "tac02": "exumi_recorders.drivers.tac02",
        "uvc": "exumi_recorders.drivers.camera_profiles:UVC",
    }
)


def driver_names() -> list[str]:
    """Return the names of all drivers, in order."""
    return sorted({*_BUILT_IN, *_added()})


def find_driver(name: str) -> DriverType:
    """Return a driver's description.

    Parameters
    ----------
    name : str
        As in ``driver = "quest"`` of a rig file.

    Raises
    ------
    UsageError
        There is none of that name, or an installed package adds a wrong one.
    MissingExtraError
        It needs an extra that is not installed.
    """
    added = _added()
    if name in added:
        return added[name]
    home = _BUILT_IN.get(name)
    if home is None:
        raise UsageError(
            f"there is no driver {name!r}", fix=f"Drivers: {', '.join(driver_names())}."
        )
    module, _, attribute = home.partition(":")
    driver: DriverType = getattr(import_module(module), attribute or "DRIVER")
    return driver


def _added() -> dict[str, DriverType]:
    found: dict[str, DriverType] = {}
    for plugin in load_plugins(DRIVERS):
        if not isinstance(plugin.value, DriverType) or plugin.value.name != plugin.name:
            raise UsageError(
                f"what {plugin.origin} registers as the driver {plugin.name!r} is no DriverType "
                "of that name",
                fix="Tell the authors of that package.",
            )
        if plugin.name in _BUILT_IN:
            refuse_twice(f"the driver {plugin.name!r}", "exumi-data", plugin.origin)
        found[plugin.name] = plugin.value
    return found
