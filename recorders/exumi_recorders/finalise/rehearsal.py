"""Streams are finalised for trial before anything is recorded: what cannot be stored is refused."""

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from exumi_data.errors import ExumiError, UsageError
from exumi_data.model.description import Source, Task
from exumi_data.model.episode import EpisodeMetadata
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_recorders.contract import Files, Port, Rows
from exumi_recorders.finalise.clocks import clock_of
from exumi_recorders.finalise.columns import Columns
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.events import EventSummary
from exumi_recorders.finalise.files import add_files
from exumi_recorders.finalise.losses import Losses
from exumi_recorders.finalise.rows import row_dtype, write_rows
from exumi_recorders.journal.header import RESERVED, StreamHeader, port_of
from exumi_recorders.journal.reading import Block
from exumi_recorders.journal.record import NONE

__all__ = ["rehearse"]


def rehearse(streams: Mapping[str, StreamHeader]) -> None:
    """Check that an episode can hold streams as their ports describe them.

    Parameters
    ----------
    streams : mapping of str to StreamHeader

    Raises
    ------
    UsageError
        It cannot; names the stream, its device, and what is wrong.
    """
    metadata = EpisodeMetadata(
        id="00000000-0000-7000-8000-000000000000",
        task=Task(name="rehearsal"),
        regime="play",
        licence="NOASSERTION",
        source=Source(type="recorded", tool="exumi", tool_version="0"),
    )
    with tempfile.TemporaryDirectory(prefix="exumi-") as folder:
        writer = EpisodeWriter(Path(folder) / "rehearsal.zarr", metadata, durable=False)
        context = Context(writer, 0, EventSummary(), {})
        try:
            for name, stream in streams.items():
                if name in RESERVED:
                    raise UsageError(
                        f"no stream can be called {name!r}",
                        fix="Give it another name in the rig file.",
                    )
                try:
                    _write_one(name, stream, context)
                except (ExumiError, ValueError, TypeError) as error:
                    what = error.what if isinstance(error, ExumiError) else str(error)
                    raise UsageError(
                        f"stream {name!r} of {stream.device} cannot be recorded: {what}",
                        fix="Correct the driver, or the device's options in the rig file.",
                    ) from error
        finally:
            writer.abort()


def _write_one(name: str, stream: StreamHeader, context: Context) -> None:
    port = port_of(stream.port)
    clock = clock_of(stream, 0, None)
    if not isinstance(port.payload, Rows):
        if isinstance(port.payload, Files) or port.kind == "audio":
            add_files(name, port, clock, context)
            return
        raise UsageError(f"a stream of kind {port.kind} has no blocks of sound", where=name)
    block = _one_row(port, row_dtype(port.payload).itemsize)
    columns = Columns(port, clock, Losses(port.modulus))
    write_rows(name, stream.device, port, clock, [block], columns, context)


def _one_row(port: Port, size: int) -> Block:
    zero = np.zeros(1, np.int64)
    none = np.full(1, NONE, np.int64)
    return Block(
        zero.astype(np.uint64),
        zero,
        none if port.time_device_unit is None else zero,
        zero,
        zero.astype(np.uint32),
        zero.astype(np.bool_),
        rows=np.zeros((1, size), np.uint8),
    )
