"""The kinds of streams (spec: Streams, registry: kinds)."""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from exumi_data.model.base import (
    WHOLE_NUMBER,
    ArrayName,
    ExtensionKind,
    Identifier,
    Model,
    Rational,
)
from exumi_data.model.clock import Clock, Gap
from exumi_data.model.images import ArrayImages, EncodedImages, Images, VideoImages

__all__ = [
    "AudioStream",
    "ExtensionStream",
    "Frames",
    "PoseStream",
    "RawData",
    "Reference",
    "RgbStream",
    "Sensor",
    "Stream",
    "StreamModel",
    "TactileStream",
    "TaxelsStream",
    "WidthStream",
    "WrenchStream",
    "images_of",
]


class Sensor(Model):
    """The device that made a stream."""

    model: Identifier
    """Registered name of the sensor model, such as ``gelsight-mini`` or ``as5600``."""
    manufacturer: str | None = None
    serial: str | None = None
    side: Literal["left", "right"] | None = None


class RawData(Model):
    """What ``raw`` holds: the device's own values, before ``data`` was computed from them."""

    unit: Identifier
    reference_frame: Identifier | None = None
    transform: Identifier | None = None
    """Name of the calibration item that leads from ``raw`` to ``data``."""
    modulus: Annotated[int, Field(ge=2)] | None = None
    """Where the counts wrap, such as 4096 for a 12-bit encoder."""


class Frames(Model):
    """The two reference frames of a pose ``T_parent_child``."""

    parent: Identifier
    child: Identifier


class Reference(Model):
    """How the no-contact image of a tactile stream was had."""

    method: Literal["captured", "selected", "estimated"]
    frames: list[Annotated[int, Field(ge=0)]] | None = None
    """Frames of the stream that it was made from."""
    contact_free: bool | None = None
    """False when every frame seems to be in contact; null when it is not known."""
    algorithm: Identifier | None = None


class StreamModel(Model):
    """What every stream has."""

    kind: str
    clock: Clock
    arrays: list[ArrayName]
    """The names of all arrays of the stream: one that is missing is damage."""
    nominal_rate: Rational | None = None
    """Samples per second as the maker states it, such as ``60000/1001``."""
    sensor: Sensor | None = None
    description: str | None = None
    time_device_unit: Identifier | None = None
    gaps: list[Gap] | None = None
    lost: dict[Identifier, Annotated[int, Field(ge=0)]] | None = None
    """Loss counters by cause, such as ``kernel``, ``queue``, ``crc``, ``late``."""


class RgbStream(StreamModel):
    """A colour or grey camera."""

    kind: Literal["rgb"]
    images: Images


class TactileStream(StreamModel):
    """A visuo-tactile sensor: images of a gel."""

    kind: Literal["tactile"]
    images: Images
    reference: Reference | None = None
    mm_per_px: (
        Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=2, max_length=2)] | None
    ) = None
    """Scale across and down, in mm per pixel."""


class PoseStream(StreamModel):
    """Poses ``T_parent_child`` as x y z qx qy qz qw, metres."""

    kind: Literal["pose"]
    frames: Frames
    raw: RawData | None = None


class WidthStream(StreamModel):
    """Gripper opening, metres."""

    kind: Literal["width"]
    raw: RawData | None = None


class WrenchStream(StreamModel):
    """Forces and torques; N and N·m."""

    kind: Literal["wrench"]
    components: Annotated[
        list[Annotated[str, Field(pattern=r"^(f|t)[a-z_]*$")]], Field(min_length=1)
    ]
    """One name a column: ``fx`` ... ``tz``, or one such as ``f_grip``."""
    reference_frame: Identifier | None = None
    raw: RawData | None = None


class TaxelsStream(StreamModel):
    """A grid of force-sensitive cells."""

    kind: Literal["taxels"]
    grid: Annotated[list[Annotated[int, Field(ge=1, le=4096)]], Field(min_length=2, max_length=2)]
    """Rows and columns."""
    unit: Identifier
    sign: Annotated[Literal[-1, 1], WHOLE_NUMBER] = 1
    """-1 when the value falls as the force grows."""
    offset: float = 0.0
    """The value without contact, in ``unit``."""
    positions_m: list[list[float]] | None = None
    """Position of each cell, row by row, x y (z), metres."""


class AudioStream(StreamModel):
    """Sound in blocks, 16 bits: what counts samples of a stream counts its blocks."""

    kind: Literal["audio"]
    rate: Rational
    """Rows of ``data`` a second, as the maker states it."""
    channels: Annotated[int, Field(ge=1, le=64)]


class ExtensionStream(StreamModel):
    """A kind of a third party: reads generically."""

    kind: ExtensionKind
    extension_version: Identifier
    schema_url: Annotated[str, Field(pattern=r"^https?://\S+$")]


def _branch(value: Any) -> str:
    kind = value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)
    return "extension" if isinstance(kind, str) and ":" in kind else str(kind)


Stream = Annotated[
    Annotated[RgbStream, Tag("rgb")]
    | Annotated[TactileStream, Tag("tactile")]
    | Annotated[PoseStream, Tag("pose")]
    | Annotated[WidthStream, Tag("width")]
    | Annotated[WrenchStream, Tag("wrench")]
    | Annotated[TaxelsStream, Tag("taxels")]
    | Annotated[AudioStream, Tag("audio")]
    | Annotated[ExtensionStream, Tag("extension")],
    Discriminator(
        _branch,
        custom_error_type="unknown_kind",
        custom_error_message="unknown stream kind; a third party's kind is named vendor:name",
    ),
]


def images_of(stream: StreamModel) -> ArrayImages | EncodedImages | VideoImages | None:
    """Return how a stream's frames are stored; None for a stream without frames.

    A third party's stream, or one of a newer version, may have a key ``images`` that means
    something else.
    """
    images = getattr(stream, "images", None)
    return images if isinstance(images, ArrayImages | EncodedImages | VideoImages) else None
