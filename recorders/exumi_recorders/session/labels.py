"""What is touched, said while it is recorded: object, part, procedure, pad; trials are counted."""

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from exumi_data.errors import UsageError
from exumi_data.model import Annotations

__all__ = ["TouchLabels", "TrialCounter"]

PadType = Literal["plain", "dotted"]
_Key = tuple[str | None, str | None, str | None]


@dataclass(frozen=True, slots=True)
class TouchLabels:
    """What the operator says about the episodes to come.

    Attributes
    ----------
    object, part : str, optional
        In plain words; the ids of the annotations are made from them.
    procedure : str, optional
        Such as press, slide or twist.
    pad_type : {"plain", "dotted"}, optional
    """

    object: str | None = None
    part: str | None = None
    procedure: str | None = None
    pad_type: PadType | None = None

    def __post_init__(self) -> None:
        if self.part is not None and self.object is None:
            raise UsageError("--part needs --object", fix="Say of which object it is a part.")
        for name in ("object", "part"):
            text = getattr(self, name)
            if text is not None and not _slug(text):
                raise UsageError(
                    f"--{name} {text!r} has no letter or digit", fix="Name it by a word."
                )

    def annotations(self, trial: int) -> Annotations | None:
        """Return the annotations of an episode; None when nothing was said.

        Parameters
        ----------
        trial : int
            How often the same was touched in the same way, this episode included.
        """
        if self == TouchLabels():
            return None
        said = {
            "object": self.object,
            "object_id": None if self.object is None else _slug(self.object),
            "part": self.part,
            "part_id": None if self.part is None else f"{_slug(self.object)}/{_slug(self.part)}",
            "procedure": self.procedure,
            "pad_type": self.pad_type,
            "trial": trial if self.object is not None else None,
        }
        return Annotations.model_validate(
            {name: value for name, value in said.items() if value is not None}
        )


def _slug(text: str | None) -> str:
    """Return an id: letters and digits of any script, and dots, in small letters; else dashes."""
    plain = unicodedata.normalize("NFKC", text or "").casefold()
    kept = (c if c == "." or unicodedata.category(c)[0] in "LMN" else "-" for c in plain)
    return re.sub("-+", "-", "".join(kept)).strip("-")


class TrialCounter:
    """Counts trials of the same touch, and sees when pad types mix.

    Parameters
    ----------
    earlier : iterable of Annotations or None
        Of the episodes that are there already.
    """

    def __init__(self, earlier: Iterable[Annotations | None] = ()) -> None:
        self._trials: Counter[_Key] = Counter()
        self._pads: Counter[str] = Counter()
        for said in earlier:
            self.add(said)

    def add(self, said: Annotations | None) -> None:
        """Count an episode that was kept."""
        if said is None:
            return
        key = _key(said)
        self._trials[key] = max(self._trials[key] + 1, said.trial or 0)
        if said.pad_type is not None:
            self._pads[said.pad_type] += 1

    def next_trial(self, labels: TouchLabels) -> int:
        """Return the number of the next trial of a touch, from 1."""
        said = labels.annotations(1)
        return 1 if said is None else self._trials[_key(said)] + 1

    def warning(self, labels: TouchLabels) -> str | None:
        """Return what to tell the operator about pad types; None when there is nothing to tell."""
        others = {pad: n for pad, n in self._pads.items() if pad != labels.pad_type}
        if not others:
            return None
        found = " and ".join(f"{n} with {pad} pads" for pad, n in sorted(others.items()))
        now = f"{labels.pad_type} pads" if labels.pad_type else "an unknown pad"
        return f"this dataset holds {found}; the next episode says {now}: are the pads right?"


def _key(said: Annotations) -> _Key:
    return (said.object_id, said.part_id, said.procedure)
