"""The masters of the standard as data: rules, kinds, units, flags, stamp points, sensors.

The tables of ``spec/`` are rendered from these files, and the validators take identifiers, levels,
severities and messages from them, so that the three cannot say different things.
"""

from exumi_data.standard.registry import (
    ArraySpec,
    Encoding,
    Flag,
    Kind,
    SensorModel,
    StampPoint,
    Unit,
    common_arrays,
    derived_arrays,
    derived_name_fault,
    encodings,
    flags,
    kinds,
    sensors,
    stamp_points,
    units,
)
from exumi_data.standard.rule_table import LEVELS, Level, Place, Rule, Severity, places, rules

__all__ = [
    "LEVELS",
    "ArraySpec",
    "Encoding",
    "Flag",
    "Kind",
    "Level",
    "Place",
    "Rule",
    "SensorModel",
    "Severity",
    "StampPoint",
    "Unit",
    "common_arrays",
    "derived_arrays",
    "derived_name_fault",
    "encodings",
    "flags",
    "kinds",
    "places",
    "rules",
    "sensors",
    "stamp_points",
    "units",
]
