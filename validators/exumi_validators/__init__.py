"""The rules of the standard as checks: one function a rule or a few, the report, its renderers.

Checks read episodes as strangers' files: bounded, never following links, never stopping at the
first mistake. Import of this package loads no image or video library; validating does.
"""

from typing import Any

from exumi_validators.report import (
    Configuration,
    Coverage,
    Extension,
    Location,
    Problem,
    Reclassified,
    Report,
    Skipped,
    Suppression,
    Unchecked,
)

__all__ = [
    "Config",
    "Configuration",
    "Coverage",
    "Extension",
    "Location",
    "Problem",
    "Reclassified",
    "Report",
    "Skipped",
    "Suppression",
    "Unchecked",
    "find_config",
    "read_config",
    "validate",
]

_LAZY = {
    "Config": "config",
    "find_config": "config",
    "read_config": "config",
    "validate": "validation",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module

        return getattr(import_module(f"exumi_validators.{_LAZY[name]}"), name)
    msg = f"module 'exumi_validators' has no attribute {name!r}"
    raise AttributeError(msg)
