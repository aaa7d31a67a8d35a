"""Panels: what a layout is made of."""

from dataclasses import dataclass
from typing import Literal

__all__ = ["Panel", "PanelKind"]

PanelKind = Literal[
    "camera", "tactile", "difference", "taxels", "space", "curves", "segments", "events", "about"
]


@dataclass(frozen=True, slots=True)
class Panel:
    """Something that was logged and has a place in the layout.

    Attributes
    ----------
    kind : str
    origin : str
        Entity that it shows, with all below.
    title : str
    """

    kind: PanelKind
    origin: str
    title: str
