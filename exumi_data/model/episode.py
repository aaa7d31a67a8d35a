"""The root document of an episode and the document of its ``derived`` group."""

from typing import Annotated, Any, Literal

from pydantic import Field

from exumi_data.model.base import (
    EpisodeId,
    Identifier,
    Model,
    Positive,
    StreamName,
    Timestamp,
    Version,
)
from exumi_data.model.description import (
    Annotations,
    CalibrationItem,
    Device,
    Embodiment,
    QualityNote,
    Source,
    Task,
)
from exumi_data.model.streams import Stream

__all__ = [
    "CONVENTION",
    "CONVENTION_UUID",
    "EPISODE_FORMAT",
    "FORMAT_VERSION",
    "UNKNOWN_LICENCE",
    "DerivedItem",
    "DerivedMetadata",
    "EpisodeMetadata",
]

EPISODE_FORMAT = "exumi-episode"
FORMAT_VERSION = "1.0"
UNKNOWN_LICENCE = "NOASSERTION"
"""SPDX's own word for a licence that is not stated."""
CONVENTION_UUID = "7d8f0a52-5a5b-4a0e-9d7c-3f2f6a1c9e10"
CONVENTION: dict[str, str] = {
    "uuid": CONVENTION_UUID,
    "name": EPISODE_FORMAT,
    "description": "exUMI Episode: one tactile robot-manipulation episode",
}
"""The entry of ``zarr_conventions`` by which generic tools recognise an episode."""


class EpisodeMetadata(Model):
    """All metadata of an episode and its streams: the ``exumi`` attribute of the root group."""

    format: Literal["exumi-episode"] = "exumi-episode"
    version: Version = FORMAT_VERSION
    id: EpisodeId
    revision: Positive = 1
    """Counts changes outside ``derived/``."""
    requires: list[Identifier] = []
    """Features without which the episode would be misread: a reader refuses unknown ones."""
    start: Timestamp | None = None
    """The epoch of all ``time`` arrays, UTC; null where the source does not know it."""
    task: Task
    regime: Literal["demonstration", "play", "touch"]
    success: bool | None = None
    operator: str | None = None
    """A pseudonym."""
    site: str | None = None
    device: Device | None = None
    embodiment: Embodiment | None = None
    streams: dict[StreamName, Stream] = {}
    calibration: dict[Identifier, CalibrationItem] = {}
    annotations: Annotations | None = None
    licence: Identifier
    """SPDX expression; ``NOASSERTION`` when it is not known."""
    source: Source
    quality: list[QualityNote] = []


class DerivedItem(Model):
    """How one derived array was computed."""

    algorithm: Identifier
    """Id and version of the method, such as ``exumi-activity/1``."""
    parameters: dict[str, Any] = {}
    inputs: list[Identifier] = []
    """Paths of the arrays it was computed from."""


class DerivedMetadata(Model):
    """The ``exumi`` attribute of the ``derived`` group: outside the digest, regenerable."""

    format: Literal["exumi-derived"] = "exumi-derived"
    version: Version = FORMAT_VERSION
    requires: list[Identifier] = []
    """Features without which it would be misread: a reader refuses unknown ones."""
    items: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*/[a-z][a-z0-9_]*$")], DerivedItem]
    """Keyed ``<stream>/<name>``."""
