"""The rules of the standard, and the places of what breaks them."""

from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, get_args

from exumi_data.standard.toml_data import read_toml

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["LEVELS", "RULE_FILES", "Level", "Place", "Rule", "Severity", "places", "rules"]

RULE_FILES = (
    "documents",
    "files",
    "samples",
    "frames",
    "derived",
    "dataset",
    "manifest",
    "timing",
    "sync",
    "touch",
    "motion",
    "labels",
)
"""The files in ``rules/``, in the order of the specification."""

Level = Literal["document", "hierarchy", "arrays", "data"]
Severity = Literal["error", "warning", "info"]

LEVELS: tuple[Level, ...] = get_args(Level)
"""From the cheapest to the dearest: the documents alone; names, shapes and codecs; the
low-dimensional arrays and how they agree; every byte and every frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """What the path, the pointer and the index of a finding are.

    Attributes
    ----------
    name : str
    path : str
        What the path names.
    pointer : bool
        Whether there is a JSON pointer.
    index : str or None
        What the index counts; None where there is none, and each such finding is one of its own.
    text : str
        What is found there.
    """

    name: str
    path: str
    text: str
    pointer: bool = False
    index: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule of the standard.

    Attributes
    ----------
    id : str
        Stable: an id is never used for anything else, also after its rule is gone.
    level : {"document", "hierarchy", "arrays", "data"}
        The cheapest level of validation that can judge it.
    severity : {"error", "warning", "info"}
        A MUST is an error, a SHOULD a warning.
    title : str
        What holds when the rule is kept.
    message : str
        What to say when it is broken; ``{path}``, ``{index}``, ``{expected}``, ``{found}`` and
        words of the check's own are filled in.
    suggestion : str
        What to do about it, in the words that a finding carries.
    why : str
        What goes wrong in data that breaks it; of a third party's rule it may be empty.
    mend : str
        What else helps, where the suggestion needs it.
    anchor : str
        Where the rule stands, below ``spec/<version>/``.
    places : tuple of str
        Names of the places that its findings may have.
    since : str
        Format version that has it.
    limits : dict
        Numbers that the rule judges by, with their unit in the name, such as ``speed_m_per_s``.
    """

    id: str
    level: Level
    severity: Severity
    title: str
    message: str
    suggestion: str
    anchor: str
    since: str
    why: str = ""
    mend: str = ""
    places: tuple[str, ...] = ()
    limits: "Mapping[str, float]" = field(default_factory=dict)

    @property
    def group(self) -> str:
        """The part of the id before the number."""
        return self.id.partition("-")[0]


@cache
def places() -> "Mapping[str, Place]":
    """Return all places of findings by name."""
    entries = read_toml("places.toml")["place"]
    return MappingProxyType({entry["name"]: Place(**entry) for entry in entries})


@cache
def rules() -> "Mapping[str, Rule]":
    """Return all rules by id, in the order of the specification."""
    found: dict[str, Rule] = {}
    for name in RULE_FILES:
        for entry in read_toml(f"rules/{name}.toml").get("rule", []):
            limits = MappingProxyType(entry.pop("limits", {}))
            rule = Rule(**{**entry, "places": tuple(entry.get("places", ()))}, limits=limits)
            if rule.id in found:
                msg = f"there are two rules {rule.id}"
                raise ValueError(msg)
            found[rule.id] = rule
    return MappingProxyType(found)
