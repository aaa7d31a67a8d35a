"""What stands in our MCAP files: topics, schemas, names of records. Both directions use it."""

import json
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

from exumi_data.errors import MissingExtraError

__all__ = [
    "ARRAYS_FOLDER",
    "DOCUMENT_RECORD",
    "JSON_SCHEMAS",
    "SAMPLE_SCHEMA",
    "VIDEO_FOLDER",
    "json_schema",
    "require_mcap",
    "topic_of",
    "video_piece",
]

DOCUMENT_RECORD = "exumi"
"""The metadata record that holds the episode's document."""
ARRAYS_FOLDER = "exumi/arrays/"
"""Attachments whose names begin with this are ``.npy`` arrays of the episode."""
VIDEO_FOLDER = "exumi/video/"
"""Attachments whose names begin with this are video files, byte for byte, or pieces of them."""
SAMPLE_SCHEMA = "exumi.Sample"
"""What is known of a sample beside what Foxglove's own message says."""

_MODULES = ("foxglove_schemas_protobuf", "mcap", "mcap_protobuf")
_NUMBER = {"type": "number"}
_TIMES = {
    "raw": {"description": "the device's own value"},
    "time_host": {"type": "integer", "description": "nanoseconds"},
    "time_device": {"type": "integer", "description": "in the device's unit"},
    "sequence": {"type": "integer"},
    "flags": {"type": "integer"},
}
JSON_SCHEMAS: Mapping[str, Mapping[str, Any]] = {
    "width": {"width_m": _NUMBER},
    "wrench": {"values": {"type": "array", "items": _NUMBER}},
    "taxels": {"values": {"type": "array", "items": {"type": "array", "items": _NUMBER}}},
}
"""Kinds that Foxglove has no schema for, and the properties of our own."""


def topic_of(stream: str) -> str:
    """Return the topic of a stream."""
    return f"/{stream}"


def video_piece(stream: str, file: int, piece: int | None) -> str:
    """Return the attachment's name of a video file, or of one piece of it.

    Parameters
    ----------
    stream : str
    file : int
    piece : int or None
        None: the whole file.
    """
    name = f"{VIDEO_FOLDER}{stream}/{file:06d}"
    return name if piece is None else f"{name}.{piece:06d}"


def json_schema(name: str, properties: Mapping[str, Any]) -> bytes:
    """Return a JSON Schema for messages.

    Parameters
    ----------
    name : str
    properties : mapping
        Beside those that every sample may have.
    """
    document = {"title": name, "type": "object", "properties": {**properties, **_TIMES}}
    return json.dumps(document).encode()


def require_mcap() -> None:
    """Check that the extra is installed.

    Raises
    ------
    MissingExtraError
        It is not.
    """
    missing = [name for name in _MODULES if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"MCAP files need {', '.join(missing)}", fix='Run: pip install "exumi-data[mcap]"'
        )
