"""What a gate of the preflight says."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

__all__ = ["Gate", "Verdict"]

Verdict = Literal["pass", "warn", "fail", "skipped"]


@dataclass(frozen=True, slots=True)
class Gate:
    """One thing that was looked at before recording.

    Attributes
    ----------
    name : str
        Such as ``rate``.
    where : str
        The device or the stream; empty for the rig as a whole.
    verdict : {"pass", "warn", "fail", "skipped"}
        With a failure nothing good can be recorded; a warning is the operator's to judge; what was
        skipped had nothing to judge by.
    found : str
    expected : str
    what_to_do : str
        Empty where there is nothing to do.
    """

    name: str
    where: str
    verdict: Verdict
    found: str
    expected: str
    what_to_do: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return asdict(self)
