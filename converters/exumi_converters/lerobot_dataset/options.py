"""What only this format can be told."""

from fractions import Fraction
from typing import Literal

from pydantic import Field

from exumi_converters.format_options import FormatOptions
from exumi_data.errors import UsageError
from exumi_data.time import parse_rate

__all__ = ["LeRobotOptions", "LeRobotReadOptions", "listed", "told_rate"]

_FASTEST = 1000


class LeRobotOptions(FormatOptions):
    """Options of writing."""

    fps: str = Field(
        "",
        description="Frames a second of the one timeline, such as 30 or 60000/1001. Default: the "
        "nominal rate of the timeline's stream.",
    )
    timeline: str = Field(
        "",
        description="Image stream whose rate and first frame the timeline has. Default: the first "
        "camera, else the first tactile sensor.",
    )
    streams: str = Field(
        "",
        description="Streams to write, separated by commas; episodes that lack one are left out. "
        "Default: those that all episodes have.",
    )
    gaps: Literal["refuse", "cut"] = Field(
        "refuse",
        description="Of an episode with a gap: refuse writes nothing, cut writes its longest "
        "stretch without one.",
    )
    action: Literal["next-state", "none"] = Field(
        "next-state",
        description="Feature action: next-state (the state of the next frame; the last repeats its "
        "own), or none.",
    )
    codec: Literal["av1", "h264"] = Field("av1", description="How videos are encoded.")
    crf: int = Field(30, ge=0, le=63, description="Quality of the videos; lower is better.")
    keyframes: int = Field(2, ge=1, le=1000, description="Every how many frames is a keyframe.")


class LeRobotReadOptions(FormatOptions):
    """Options of reading."""

    tactile: str = Field(
        "",
        description="Image features of tactile sensors, separated by commas; others are rgb. "
        "Default: what exUMI declared.",
    )
    pose: str = Field(
        "",
        description="Poses that names do not tell, as <feature>:<first column>:<order>, separated "
        "by commas; order is xyzw, wxyz (quaternions) or rotvec, after x y z in metres.",
    )
    width: str = Field(
        "",
        description="Widths that names do not tell, as <feature>:<column>, in metres.",
    )
    frames: str = Field(
        "", description="Reference frames of poses, as <parent>/<child>. Default: unknown."
    )


def told_rate(text: str) -> Fraction:
    """Read the option ``fps``.

    Raises
    ------
    UsageError
        It is no rate, or one of more than 1000.
    """
    try:
        rate = parse_rate(text)
    except ValueError as error:
        raise UsageError(f"Invalid fps ({text}): {error}") from None
    if rate > _FASTEST:
        raise UsageError(f"Invalid fps ({text}): at most {_FASTEST} frames a second are written")
    return rate


def listed(text: str) -> list[str]:
    """Return the parts of a list that is separated by commas."""
    return [part.strip() for part in text.split(",") if part.strip()]
