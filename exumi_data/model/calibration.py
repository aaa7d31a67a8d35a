"""Values of the calibration items that the standard defines (spec: Calibration)."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from exumi_data.model.base import Model

__all__ = ["INTRINSICS", "RECTIFICATION", "RIG_REFERENCE", "Intrinsics", "Rectification"]

INTRINSICS = "intrinsics/"
"""A calibration item of this name and a stream's says how its camera sees: `Intrinsics`."""
RECTIFICATION = "rectification/"
"""A calibration item of this name and a stream's straightens its frames: `Rectification`."""
RIG_REFERENCE = "tactile_reference/"
"""A calibration item of this name and a stream's holds the image of the rig's own finger."""

_Length = Annotated[float, Field(gt=0)]
_Side = Annotated[int, Field(ge=1, le=65535)]
_COEFFICIENTS = {"fisheye": (0, 4), "pinhole": (0, 4, 5, 8, 12, 14)}


class Intrinsics(Model):
    """How a camera maps directions to pixels; whole numbers are the centres of pixels."""

    model: Literal["pinhole", "fisheye"]
    """As OpenCV defines them: its general model, and ``cv::fisheye`` (Kannala and Brandt)."""
    width: _Side
    """Of the images that it holds for, pixels."""
    height: _Side
    fx: _Length
    """Focal length across, pixels."""
    fy: _Length
    """Focal length down, pixels."""
    cx: float
    """Principal point from the left, pixels."""
    cy: float
    """Principal point from the top, pixels."""
    skew: float = 0.0
    """Row 0, column 1 of the camera's matrix."""
    distortion: list[float] = []
    """Coefficients in OpenCV's order: of a fisheye 4, of a pinhole 4, 5, 8, 12 or 14, or none."""

    @model_validator(mode="after")
    def _as_many_as_there_are(self) -> "Intrinsics":
        known = _COEFFICIENTS[self.model]
        if len(self.distortion) not in known:
            msg = f"a {self.model} has {known} coefficients of distortion, not "
            raise ValueError(f"{msg}{len(self.distortion)}")
        return self


class Rectification(Model):
    """Which part of a rectified tactile image shows the gel, and its scale."""

    centre_px: Annotated[list[float], Field(min_length=2, max_length=2)]
    """Row and column of the rectified image that the crop is centred on."""
    crop_px: Annotated[list[_Side], Field(min_length=2, max_length=2)]
    """Rows and columns of the crop: it begins at ``centre_px - crop_px / 2``, rounded down."""
    mm_per_px: Annotated[list[_Length], Field(min_length=2, max_length=2)] | None = None
    """Scale of the rectified image across and down, mm per pixel."""
