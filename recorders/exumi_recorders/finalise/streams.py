"""One stream of a journal becomes one stream of an episode; memory stays at a block."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.errors import DamagedDataError
from exumi_data.model.clock import Clock
from exumi_data.model.images import EncodedImages
from exumi_data.store import jpeg
from exumi_data.time import parse_rate
from exumi_recorders.contract import Blocks, Files, Port, Rows
from exumi_recorders.finalise.clocks import StreamTimes, clock_of
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.losses import FLAG, KNOWN_FLAGS, MOST_GAPS, Losses
from exumi_recorders.finalise.rows import row_dtype, transform_of
from exumi_recorders.finalise.touch import ReferenceFrames, set_rig_reference
from exumi_recorders.journal.header import StreamHeader, port_of
from exumi_recorders.journal.reading import Block, Damage, LogReader
from exumi_recorders.journal.record import NONE

__all__ = ["finish_stream", "payload_bytes_of"]

_GAP_PERIODS = 2.5
_FEWEST_FOR_MEDIAN = 32


def payload_bytes_of(stream: StreamHeader) -> int | None:
    """Return the length of all payloads of a stream; None where they differ.

    Parameters
    ----------
    stream : StreamHeader
    """
    payload = port_of(stream.port).payload
    return row_dtype(payload).itemsize if isinstance(payload, Rows) else None


def finish_stream(name: str, stream: StreamHeader, log: LogReader, context: Context) -> None:
    """Write a stream; one without a single sample is left out, with a note.

    Parameters
    ----------
    name : str
    stream : StreamHeader
    log : LogReader
    context : Context
    """
    port = port_of(stream.port)
    if isinstance(port.payload, Blocks):
        context.note("stream-not-supported", "the format has no place for sound yet", name)
        return
    clock = clock_of(stream, context.t0_ns, context.events.stamp_sigma_of(stream.device))
    losses = Losses(port.modulus)
    work = _Images(name, stream, port, clock, context) if isinstance(port.payload, Files) else None
    out: Any
    columns = _Columns(port, clock, losses)
    if work is not None:
        out = work.write(log, columns)
    else:
        out = _write_rows(name, stream, port, clock, log, columns, context)
    columns.finish()
    context.counts[name] = losses.count
    _leave_notes(name, log.damages, context)
    if out is None:
        context.note("stream-empty", "left out: not a single sample was recorded", name)
        return
    _finish_losses(name, stream, losses, out, context)


class _Columns:
    """Makes the arrays beside the samples, block by block."""

    def __init__(self, port: Port, clock: Clock, losses: Losses) -> None:
        self._times = StreamTimes(clock)
        self._losses = losses
        self._with_device_time: bool | None = None
        self._with_sequence: bool | None = None
        self._last_host: int | None = None
        self._left_out = self._damaged = 0
        rate = None if port.nominal_rate is None else parse_rate(port.nominal_rate)
        self._period_ns = None if rate is None else float(1_000_000_000 / rate)
        self._has_unit = port.time_device_unit is not None

    def of(
        self, block: Block, kept: npt.NDArray[np.bool_] | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return `time` and what is beside it, for the records that are kept.

        Parameters
        ----------
        block : Block
        kept : (N,) bool, optional
        """
        if kept is None:
            kept = np.ones(len(block), np.bool_)
        host = block.time_host[kept]
        damaged, left_out = self._before_kept(block.damaged, kept)
        raw_sequence = block.sequence[kept]
        first = self._losses.count
        numbered = self._losses.take(
            block.seq[kept], raw_sequence, block.flags[kept], damaged=damaged, left_out=left_out
        )
        times, nudged = self._times.take(host)
        flags = (block.flags[kept] & np.uint32(KNOWN_FLAGS)) | numbered.flags
        flags[nudged] |= FLAG["time_nudged"]
        columns: dict[str, npt.NDArray[Any]] = {"time": times, "time_host": host, "flags": flags}
        if self._with_sequence is None and len(host):
            self._with_sequence = numbered.sequence is not None
            has_device = bool((block.time_device[kept] != NONE).all())
            self._with_device_time = has_device and self._has_unit
        if self._with_sequence:
            columns["sequence"] = self._sequence(numbered.sequence, len(host))
        else:
            self._gaps_in_time(host, flags, first)
        if self._with_device_time:
            columns["time_device"] = block.time_device[kept]
        if len(host):
            self._last_host = int(host[-1])
        return columns

    def _before_kept(
        self, damaged: npt.NDArray[np.bool_], kept: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
        """Return what lies between a kept record and the one before: damage, and others."""
        index = np.flatnonzero(kept)
        left_out = np.diff(index, prepend=-1) - 1
        running = np.cumsum(damaged)
        since = np.diff(running[index], prepend=0)
        if not len(index):
            self._left_out += len(kept)
            self._damaged += int(running[-1]) if len(running) else 0
            return since > 0, left_out
        left_out[0] += self._left_out
        since[0] += self._damaged
        self._left_out = len(kept) - 1 - int(index[-1])
        self._damaged = int(running[-1] - running[index[-1]])
        return since > 0, left_out

    def finish(self) -> None:
        """Note what was left out after the last sample."""
        if self._left_out:
            self._losses.left_out_at_the_end(self._left_out)

    def _sequence(self, found: npt.NDArray[np.uint64] | None, count: int) -> npt.NDArray[np.uint64]:
        # A driver whose first samples have numbers, and later ones have not, is wrong; its samples
        # are not.
        return np.zeros(count, np.uint64) if found is None else found

    def _gaps_in_time(
        self, host: npt.NDArray[np.int64], flags: npt.NDArray[np.uint32], first: int
    ) -> None:
        """Without numbers, a gap is where nothing came for more than 2.5 periods."""
        if not len(host):
            return
        before = host[0] if self._last_host is None else self._last_host
        intervals = np.diff(host, prepend=before)
        usual = float(np.median(intervals)) if len(host) >= _FEWEST_FOR_MEDIAN else 0.0
        period = max(self._period_ns or 0.0, usual)
        if period <= 0:
            return
        for index in np.flatnonzero(intervals > _GAP_PERIODS * period).tolist():
            if not flags[index] & FLAG["gap_before"]:
                flags[index] |= FLAG["gap_before"]
                self._losses.gap(first + index - 1, "no sample came")


def _write_rows(
    name: str,
    stream: StreamHeader,
    port: Port,
    clock: Clock,
    log: Iterable[Block],
    columns: _Columns,
    context: Context,
) -> Any:
    assert isinstance(port.payload, Rows)  # noqa: S101  # the caller saw to it
    dtype = row_dtype(port.payload)
    out: Any = None
    for block in log:
        if out is None:
            transform = transform_of(port, stream.device, name, context)
            fields = {**port.metadata, **transform.fields}
            out = context.writer.add_stream(
                name, kind=port.kind, clock=clock, **_common(port), **fields
            )
            if port.valid is not None:
                out.set_valid(np.array(port.valid, np.bool_))
        assert block.rows is not None  # noqa: S101  # the log has rows of one length
        rows = block.rows.view(dtype).reshape(len(block))
        values = transform.values(rows, block.time_host)
        beside = columns.of(block)
        beside["flags"] = beside["flags"] | values.flags
        raw = {} if values.raw is None else {"raw": values.raw}
        out.append(beside.pop("time"), values.data, **raw, **beside)
    return out


def _common(port: Port) -> dict[str, Any]:
    """Return the fields that all kinds have, where they are known."""
    fields = {
        "nominal_rate": port.nominal_rate,
        "sensor": port.sensor,
        "time_device_unit": port.time_device_unit,
    }
    return {key: value for key, value in fields.items() if value is not None}


class _Images:
    """Files of images: kept byte for byte, never decoded."""

    def __init__(
        self, name: str, stream: StreamHeader, port: Port, clock: Clock, context: Context
    ) -> None:
        assert isinstance(port.payload, Files)  # noqa: S101  # the caller saw to it
        self._name = name
        self._port = port
        self._clock = clock
        self._context = context
        self._size = (port.payload.height, port.payload.width, port.payload.channels)
        self._left_out = 0
        self._reference = ReferenceFrames.wanted(stream.port.kind, name, context)

    def write(self, log: Iterable[Block], columns: _Columns) -> Any:
        """Write the stream; None where there is not a single frame.

        Parameters
        ----------
        log : iterable of Block
        columns : _Columns
        """
        out: Any = None
        for block in log:
            kept = np.array([self._is_whole(file) for file in block.files], np.bool_)
            self._left_out += int((~kept).sum())
            beside = columns.of(block, kept)
            if not kept.any():
                continue
            if out is None:
                out = self._add()
            first = out.count
            files = block.files if kept.all() else _chosen(block.files, kept)
            if self._reference is not None:
                self._reference.take(first, beside["time_host"], files)
            out.append(beside.pop("time"), files, **beside)
        if self._left_out:
            self._context.note(
                "frames-left-out",
                f"{self._left_out} files were no JPEG of {self._size[1]}x{self._size[0]} with "
                f"{self._size[2]} channels",
                self._name,
            )
        if out is not None:
            set_rig_reference(out, self._name, self._context, self._reference)
        return out

    def _add(self) -> Any:
        height, width, channels = self._size
        images = EncodedImages(
            encoding="encoded",
            media_type="image/jpeg",
            height=height,
            width=width,
            channels=3 if channels == 3 else 1,
        )
        return self._context.writer.add_stream(
            self._name,
            kind=self._port.kind,
            clock=self._clock,
            images=images,
            **_common(self._port),
            **{key: value for key, value in self._port.metadata.items() if key != "images"},
        )

    def _is_whole(self, file: bytes) -> bool:
        if not jpeg.is_jpeg(file):
            return False
        try:
            return jpeg.size_of(file) == self._size
        except DamagedDataError:
            return False


def _chosen(files: list[bytes], kept: npt.NDArray[np.bool_]) -> list[bytes]:
    return [file for file, good in zip(files, kept.tolist(), strict=True) if good]


def _leave_notes(name: str, damages: list[Damage], context: Context) -> None:
    if not damages:
        return
    known = sum(damage.lost or 0 for damage in damages)
    length = sum(damage.bytes for damage in damages)
    where = ", ".join(
        f"{damage.path.name} at {damage.offset} ({damage.what})" for damage in damages[:5]
    )
    more = f" and {len(damages) - 5} more" if len(damages) > 5 else ""
    context.note(
        "journal-damaged",
        f"{length} bytes of the journal hold no whole record, {known} or more records are lost: "
        f"{where}{more}",
        name,
    )


def _finish_losses(
    name: str, stream: StreamHeader, losses: Losses, out: Any, context: Context
) -> None:
    counted = context.events.lost_of(name)
    # What was dropped after the last sample leaves no hole.
    behind = counted.get("queue", 0) - losses.lost.get("queue", 0)
    if behind > 0 and not losses.lost.get("journal"):
        losses.gap(losses.count - 1, "the disk could not keep up", behind)
    if stream.device in context.events.gone:
        losses.gap(losses.count - 1, "the device was gone")
    lost = dict(losses.lost)
    for cause, number in counted.items():
        lost[cause] = max(number, lost.get(cause, 0))
    out.model.gaps = losses.gaps()
    out.model.lost = {cause: number for cause, number in sorted(lost.items()) if number > 0} or None
    if losses.unlisted:
        context.note(
            "gaps-not-listed",
            f"there are {losses.unlisted} more gaps than the {MOST_GAPS} that are listed; they are "
            "flagged gap_before",
            name,
        )
