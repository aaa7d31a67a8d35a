"""``header.json``: what a journal needs besides its logs to become an episode."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator

from exumi_data.errors import MetadataError, UsageError
from exumi_data.model.base import Identifier, Int64, Model, Rational, StreamName, Version
from exumi_data.model.clock import StampPoint
from exumi_data.model.documents import check_version, dump, load_json, problems_of
from exumi_data.model.episode import EpisodeMetadata
from exumi_data.model.streams import Sensor
from exumi_data.store.zarr_document import DTYPES
from exumi_recorders.contract import Blocks, Files, Payload, Port, Rows
from exumi_recorders.journal.record import MAX_PAYLOAD_BYTES

__all__ = [
    "CLOCK_LOG",
    "EVENTS_LOG",
    "HEADER_LOG",
    "JOURNAL_FORMAT",
    "RESERVED",
    "JournalHeader",
    "KnownLatency",
    "PortDocument",
    "StreamHeader",
    "parse_header",
    "port_document",
    "port_of",
]

JOURNAL_FORMAT = "exumi-journal"
EVENTS_LOG = "events"
CLOCK_LOG = "clock"
HEADER_LOG = "header"
"""Holds the header once more, as a record with a checksum: without a header all is lost."""
RESERVED = frozenset((EVENTS_LOG, CLOCK_LOG, HEADER_LOG, "calibration"))
"""What no stream can be called: a journal has folders of these names."""


class ArrayLayout(Model):
    """One array that a row holds."""

    name: Literal["data", "raw"]
    dtype: str
    shape: list[Annotated[int, Field(ge=1, le=1 << 16)]]

    @field_validator("dtype")
    @classmethod
    def _of_the_format(cls, value: str) -> str:
        try:
            known = np.dtype(value).name in DTYPES
        except TypeError:
            known = False
        if not known or value.startswith(">"):
            msg = f"{value!r} is no data type of the format, little-endian"
            raise ValueError(msg)
        return value


class RowsDocument(Model):
    """See `Rows`."""

    form: Literal["rows"]
    arrays: Annotated[list[ArrayLayout], Field(min_length=1, max_length=2)]

    @model_validator(mode="after")
    def _bounded(self) -> "RowsDocument":
        if len({each.name for each in self.arrays}) != len(self.arrays):
            msg = "an array stands there twice"
            raise ValueError(msg)
        size = sum(
            np.dtype(each.dtype).itemsize * int(np.prod(each.shape, dtype=np.float64))
            for each in self.arrays
        )
        if size > MAX_PAYLOAD_BYTES:
            msg = f"a row has {size:,} bytes; at most {MAX_PAYLOAD_BYTES:,} are recorded"
            raise ValueError(msg)
        return self


class FilesDocument(Model):
    """See `Files`."""

    form: Literal["files"]
    media_type: Literal["image/jpeg"] = "image/jpeg"
    height: Annotated[int, Field(ge=1, le=65535)]
    width: Annotated[int, Field(ge=1, le=65535)]
    channels: Literal[1, 3]


class BlocksDocument(Model):
    """See `Blocks`."""

    form: Literal["blocks"]
    channels: Annotated[int, Field(ge=1, le=64)]
    rate: Rational


class PortDocument(Model):
    """A `Port` as it is written down."""

    name: str
    kind: str
    payload: Annotated[RowsDocument | FilesDocument | BlocksDocument, Field(discriminator="form")]
    stamp_point: StampPoint
    nominal_rate: Rational | None = None
    transform: Literal["world_frame", "encoder_map"] | None = None
    droppable: bool = False
    modulus: Annotated[int, Field(ge=2)] | None = None
    time_device_unit: str | None = None
    sensor: Sensor | None = None
    valid: list[list[bool]] | None = None
    lossy: str | None = None
    metadata: dict[str, Any] = Field(default_factory=dict)


class KnownLatency(Model):
    """What is known of a stream's latency when the recording begins."""

    latency_ns: Int64 = 0
    latency_sigma_ns: Annotated[float, Field(ge=0)] | None = None
    method: str | None = None


class StreamHeader(Model):
    """One stream: the device and port that it comes from, and how late it is."""

    device: Identifier
    port: PortDocument
    latency: KnownLatency = KnownLatency()


class JournalHeader(Model):
    """The document ``header.json``."""

    format: Literal["exumi-journal"] = "exumi-journal"
    version: Version = "1.0"
    boot_id: str
    """Of the system: host times of two boots cannot be compared."""
    t0_monotonic_ns: Int64
    """CLOCK_MONOTONIC at the episode's start."""
    episode: EpisodeMetadata
    """The episode's own document, without streams."""
    streams: dict[StreamName, StreamHeader]

    @model_validator(mode="after")
    def _consistent(self) -> "JournalHeader":
        if taken := RESERVED & set(self.streams):
            msg = f"no stream can be called {min(taken)!r}: a log or folder of the journal is"
            raise ValueError(msg)
        if self.episode.streams:
            msg = "the episode has streams already"
            raise ValueError(msg)
        for name, stream in self.streams.items():
            if stream.port.stamp_point == "nominal_rate":
                msg = f"stream {name!r} is stamped by nothing but its rate: it cannot be recorded"
                raise ValueError(msg)
        return self

    def to_json(self) -> bytes:
        """Return the document's bytes."""
        return (json.dumps(dump(self), indent=1, ensure_ascii=False) + "\n").encode()


def parse_header(raw: bytes, where: Path) -> JournalHeader:
    """Parse ``header.json``.

    Parameters
    ----------
    raw : bytes
    where : pathlib.Path
        Named in errors.

    Raises
    ------
    MetadataError
        It is none.
    UnsupportedError
        It is of a newer version.
    """
    document = load_json(raw, where)
    newer = check_version(document, JOURNAL_FORMAT, where)
    try:
        return JournalHeader.model_validate_json(
            json.dumps(document), context={"newer_minor": newer}
        )
    except ValidationError as error:
        problems = tuple(f"{message} @ {path}" for message, path in problems_of(error))
        raise MetadataError("; ".join(problems[:5]), where=where, problems=problems) from None


def port_document(port: Port) -> PortDocument:
    """Write a port down.

    Parameters
    ----------
    port : Port

    Raises
    ------
    UsageError
        It cannot be recorded as it is.
    """
    fields = {
        "name": port.name,
        "kind": port.kind,
        "payload": _payload_document(port.payload),
        "stamp_point": port.stamp_point,
        "nominal_rate": port.nominal_rate,
        "transform": port.transform,
        "droppable": port.droppable,
        "modulus": port.modulus,
        "time_device_unit": port.time_device_unit,
        "sensor": None if port.sensor is None else dump(port.sensor),
        "valid": port.valid,
        "lossy": port.lossy,
        "metadata": {key: _plain(value) for key, value in port.metadata.items()},
    }
    given = {key: value for key, value in fields.items() if value is not None}
    try:
        return PortDocument.model_validate_json(json.dumps(given))
    except (TypeError, ValueError) as error:
        raise UsageError(f"port {port.name!r} cannot be recorded: {error}") from None


def _payload_document(payload: Payload) -> dict[str, Any]:
    if isinstance(payload, Rows):
        arrays = [
            {"name": name, "dtype": dtype, "shape": list(shape)}
            for name, (dtype, shape) in payload.arrays.items()
        ]
        return {"form": "rows", "arrays": arrays}
    if isinstance(payload, Files):
        size = {"height": payload.height, "width": payload.width, "channels": payload.channels}
        return {"form": "files", "media_type": payload.media_type, **size}
    return {"form": "blocks", "channels": payload.channels, "rate": payload.rate}


def _plain(value: Any) -> Any:
    """Turn what a driver's author may write (models, tuples) into JSON values."""
    if isinstance(value, Model):
        return dump(value)
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def port_of(document: PortDocument) -> Port:
    """Return the port that was written down.

    Parameters
    ----------
    document : PortDocument
    """
    given = document.payload
    payload: Payload
    if isinstance(given, RowsDocument):
        payload = Rows({each.name: (each.dtype, tuple(each.shape)) for each in given.arrays})
    elif isinstance(given, FilesDocument):
        payload = Files(given.height, given.width, given.channels, given.media_type)
    else:
        payload = Blocks(given.channels, given.rate)
    return Port(
        name=document.name,
        kind=document.kind,
        payload=payload,
        stamp_point=document.stamp_point,
        nominal_rate=document.nominal_rate,
        transform=document.transform,
        droppable=document.droppable,
        modulus=document.modulus,
        time_device_unit=document.time_device_unit,
        sensor=document.sensor,
        valid=None if document.valid is None else tuple(map(tuple, document.valid)),
        lossy=document.lossy,
        metadata=document.metadata,
    )
