"""Task, device, calibration, annotations, source and quality notes of an episode."""

from typing import Annotated, Any, Literal

from pydantic import Field

from exumi_data.model.base import Count, Identifier, Int64, Model, Sha256, StreamName, Timestamp

__all__ = [
    "Annotations",
    "CalibrationItem",
    "Device",
    "Embodiment",
    "InputFile",
    "Label",
    "LossyStep",
    "QualityNote",
    "Segment",
    "Source",
    "Task",
]


class Task(Model):
    """What was to be done."""

    name: Identifier
    instruction: str | None = None
    """The task in plain language, as a policy would be told."""


class Device(Model):
    """What the data was collected with."""

    name: Identifier
    serial: str | None = None
    hub: str | None = None


class Embodiment(Model):
    """The gripper or hand that touched the world."""

    name: Identifier
    gripper: Literal["parallel", "angular", "none"] = "parallel"
    """Whether the opening is a width (metres) or an angle (radians)."""
    max_width_m: Annotated[float, Field(gt=0)] | None = None


class CalibrationItem(Model):
    """A calibrated quantity with what is known about it."""

    value: Any
    unit: Identifier | None = None
    uncertainty: Annotated[float, Field(ge=0)] | None = None
    residual: Annotated[float, Field(ge=0)] | None = None
    method: str | None = None
    procedure: str | None = None
    time: Timestamp | None = None
    digest: Sha256 | None = None
    """SHA-256 of what it was made from: a file's, or an episode's digest."""
    array: str | None = None
    """Path of an array under ``calibration/``, when the value is too big for JSON."""


class Label(Model):
    """A judgement about the object that was touched."""

    property: Identifier
    value: float | str | list[str] | None
    scale: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    """Lowest and highest possible value of a number."""
    raters: Annotated[int, Field(ge=1)] | None = None
    provenance: Literal["human", "model"]
    origin: str | None = None
    """Where the label was taken from."""


class Segment(Model):
    """A named stretch of time."""

    name: Identifier
    start_ns: Int64
    end_ns: Int64


class Annotations(Model):
    """What was touched, and how."""

    object_id: Identifier | None = None
    object: str | None = None
    part_id: Identifier | None = None
    part: str | None = None
    instance_id: Identifier | None = None
    trial: Count | None = None
    procedure: Identifier | None = None
    """Exploratory procedure, such as press, slide or twist."""
    pad_type: Literal["plain", "dotted"] | None = None
    labels: list[Label] | None = None
    segments: list[Segment] | None = None


class InputFile(Model):
    """A file that an episode was made from."""

    name: Identifier
    sha256: Sha256
    bytes: Annotated[int, Field(ge=0)] | None = None


class LossyStep(Model):
    """A step at which information was lost."""

    step: Identifier
    stream: StreamName | None = None
    detail: str
    parameters: dict[str, Any] | None = None
    by: str | None = None
    """Which tool did it, if it was not the tool named in ``source``."""


class Source(Model):
    """Where the episode comes from. Converted metadata holds no wall-clock time."""

    type: Literal["recorded", "converted", "simulated"]
    tool: Identifier
    tool_version: Identifier
    converter: Identifier | None = None
    key: str | None = None
    """Which part of the inputs this episode is."""
    inputs: list[InputFile] | None = None
    settings: dict[str, Any] | None = None
    settings_sha256: Sha256 | None = None
    """Digest of everything besides ``inputs`` that shaped the episode: resume compares it."""
    lossy: list[LossyStep] | None = None
    parent_id: str | None = None
    """Id of the episode that this one was derived from."""
    parent_digest: Sha256 | None = None


class QualityNote(Model):
    """Something that a user of the episode should know."""

    code: Identifier
    message: str
    stream: StreamName | None = None
    severity: Literal["info", "warning"] = "warning"
