"""The rules of the standard as checks: one function a rule or a few, the report, its renderers.

Checks read episodes as strangers' files: bounded, never following links, never stopping at the
first mistake. Import of this package loads no image or video library; validating does.
"""

from typing import Any

from exumi_validators.report import Coverage, Location, Problem, Report, Skipped, Unchecked

__all__ = ["Coverage", "Location", "Problem", "Report", "Skipped", "Unchecked", "validate"]


def __getattr__(name: str) -> Any:
    if name == "validate":
        from exumi_validators.validation import validate

        return validate
    msg = f"module 'exumi_validators' has no attribute {name!r}"
    raise AttributeError(msg)
