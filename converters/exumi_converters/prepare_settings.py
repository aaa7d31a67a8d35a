"""How frames are made ready for training."""

from dataclasses import dataclass
from typing import Any, Literal

__all__ = ["DEFAULT_FOV_DEG", "PrepareSettings"]

DEFAULT_FOV_DEG = 90.0
"""Field of view of rectified frames: about what a wide lens sees without much stretching."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PrepareSettings:
    """How frames are made ready.

    Attributes
    ----------
    size : int
        Edge of the square frames, pixels.
    gray : bool
        Keep the luma of tactile streams only.
    quality : int or None
        Of the JPEGs; None stores pixels without loss.
    tactile : {"separate", "combined"}
        One image a finger, or one of both.
    rgb : {"resize", "rectify"}
        Whether the distortion of cameras is taken out.
    fov_deg : float
        Field of view of rectified camera frames, degrees.
    pair_within_ns : int or None
        How far the frames of two fingers may be apart; None: one frame interval.
    """

    size: int = 224
    gray: bool = False
    quality: int | None = 95
    tactile: Literal["separate", "combined"] = "separate"
    rgb: Literal["resize", "rectify"] = "resize"
    fov_deg: float = DEFAULT_FOV_DEG
    pair_within_ns: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the settings as they are put on record: those that play a part."""
        found: dict[str, Any] = {"size": self.size, "gray": self.gray}
        found |= {"lossless": True} if self.quality is None else {"quality": self.quality}
        found |= {"tactile": self.tactile, "rgb": self.rgb}
        if self.rgb == "rectify":
            found["fov_deg"] = self.fov_deg
        if self.tactile == "combined" and self.pair_within_ns is not None:
            found["pair_within_ns"] = self.pair_within_ns
        return found
