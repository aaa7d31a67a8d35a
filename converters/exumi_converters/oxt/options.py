"""What only this format can be told."""

from typing import Literal

from pydantic import Field, field_validator

from exumi_converters.format_options import FormatOptions
from exumi_converters.oxt.contract import CAMERAS, tactile_key
from exumi_data.time import parse_rate

__all__ = ["OxtOptions", "OxtReadOptions", "parse_assignments"]

LEFT_OUT = "-"
_SIDES = ("left", "right")
_KEYS = (
    *CAMERAS,
    "camera_ego_pose",
    *(f"{side}_wrist_pose" for side in _SIDES),
    *(f"{side}_hand_joints" for side in _SIDES),
)


class OxtOptions(FormatOptions):
    """Of writing."""

    timeline: str = Field(
        "",
        description="Stream whose times are the steps; without it the camera's (of several, the "
        "one of the wrist).",
    )
    rate: str = Field(
        "",
        description="Steps a second instead, such as 30 or 60000/1001, from where all streams "
        "have begun.",
    )
    gaps: Literal["cut", "refuse"] = Field(
        "cut",
        description="Where a stream has no value for a step: cut (what lies before and after are "
        "episodes of their own) or refuse (the episode is not written).",
    )
    side: Literal["left", "right"] = Field("right", description="Hand that one gripper stands for.")
    axes: Literal["kept", "umi"] = Field(
        "kept",
        description="Axes of the gripper: kept, or umi (z forward, x right, y down: they are "
        "turned to the contract's z forward, x down, y left).",
    )
    streams: str = Field(
        "",
        description="Places of streams, such as "
        "rgb_2=camera_main_rgb,pad=left_tactile_data_gripper:0,head=- (:0 is the area; - leaves "
        "the stream out).",
    )

    @field_validator("rate")
    @classmethod
    def _check_rate(cls, value: str) -> str:
        if value:
            parse_rate(value)
        return value

    @field_validator("streams")
    @classmethod
    def _check_streams(cls, value: str) -> str:
        parse_assignments(value)
        return value


def parse_assignments(text: str) -> dict[str, tuple[str, int | None]]:
    """Read places that the user names.

    Parameters
    ----------
    text : str
        ``stream=key`` or ``stream=key:area``, separated by commas.

    Returns
    -------
    dict of str to (str, int or None)
        Stream to key and area.

    Raises
    ------
    ValueError
        It is no such text.
    """
    found: dict[str, tuple[str, int | None]] = {}
    for entry in filter(None, (part.strip() for part in text.split(","))):
        stream, equals, place = entry.partition("=")
        key, colon, area = place.partition(":")
        parts = tactile_key(key)
        tactile = parts is not None and parts.what == "data"
        if not equals or not (tactile or key in (LEFT_OUT, *_KEYS)):
            msg = f"{entry!r} names no place of a stream; places are {', '.join(_KEYS)} and those "
            raise ValueError(msg + "of the form right_tactile_data_GROUP:AREA")
        if colon and not (tactile and area.isdecimal() and int(area) <= 23):  # as many areas exist
            msg = f"{entry!r} names no area: tactile data have areas from 0 to 23"
            raise ValueError(msg)
        if stream in found:
            msg = f"{stream!r} is named twice"
            raise ValueError(msg)
        found[stream] = (key, int(area) if colon else None)
    return found


class OxtReadOptions(FormatOptions):
    """Of reading."""

    timestamps: Literal["auto", "s", "ms", "us", "ns", "number"] = Field(
        "auto",
        description="Unit of the timestamps; number: they count steps, and --rate says how many a "
        "second. Auto goes by their distance, and says so.",
    )
    gripper: Literal["auto", "m", "dm", "cm", "mm", "skip"] = Field(
        "auto",
        description="Unit of a gripper's number (slot 28), which the contract leaves open. Auto "
        "reads it only where the store states it.",
    )
    images: Literal["lossless", "jpeg"] = Field(
        "lossless",
        description="Camera images: pixels, or JPEG. Tactile images are always pixels.",
    )
    quality: int = Field(95, ge=1, le=100, description="Quality of JPEG.")
    regime: Literal["demonstration", "play"] = Field(
        "demonstration", description="What the episodes are."
    )
