"""One stream of a journal becomes one stream of an episode; memory stays at a block."""

from typing import Any

from exumi_data.ahead import ahead
from exumi_data.model.description import LossyStep
from exumi_data.time import parse_rate
from exumi_recorders.contract import Rows
from exumi_recorders.finalise.clocks import clock_of
from exumi_recorders.finalise.columns import Columns
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.files import write_files
from exumi_recorders.finalise.losses import MOST_GAPS, Losses
from exumi_recorders.finalise.rows import write_rows
from exumi_recorders.journal.header import StreamHeader, port_of
from exumi_recorders.journal.reading import Damage, LogReader

__all__ = ["finish_stream"]

_DAMAGES_SHOWN = 5
_SILENT_S = 1.0
_SILENT_PERIODS = 5.0


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
    clock = clock_of(stream, context.t0_ns, context.events.stamp_sigma_of(stream.device))
    losses = Losses(port.modulus)
    columns = Columns(port, clock, losses)
    if isinstance(port.payload, Rows):
        out = write_rows(name, stream.device, port, clock, ahead(log), columns, context)
    else:
        out = write_files(name, port, clock, ahead(log), columns, context)
    columns.finish()
    context.counts[name] = losses.count
    if out is None:
        # A note cannot be one of a stream that is not there.
        context.note("stream-empty", f"{name} is left out: not a single sample was recorded")
    _note_damages(name, log.damages, context, is_there=out is not None)
    if out is None:
        return
    _note_tracking(name, stream, context)
    _finish_losses(name, stream, columns, losses, out, context)
    if port.lossy is not None:
        source = context.writer.metadata.source
        step = LossyStep(step="jpeg-encode", stream=name, detail=port.lossy)
        source.lossy = [*(source.lossy or []), step]


def _declare_silence(
    name: str, stream: StreamHeader, columns: Columns, losses: Losses, context: Context
) -> None:
    """Declare that nothing came at the start or at the end; what lies between shows itself."""
    if columns.first_ns is None or columns.last_ns is None:
        return
    rate = stream.port.nominal_rate
    period_s = 0.0 if rate is None else 1.0 / float(parse_rate(rate))
    allowed_s = max(_SILENT_S, _SILENT_PERIODS * period_s)
    early_s = (columns.first_ns - context.t0_ns) / 1e9
    if early_s > allowed_s:
        losses.gap(-1, "no sample came")
        context.note("stream-silent", f"nothing came in the first {early_s:.1f} s", name)
    end_ns = context.events.stopped_ns
    late_s = 0.0 if end_ns is None else (end_ns - columns.last_ns) / 1e9
    if late_s > allowed_s:
        losses.gap(losses.count - 1, "no sample came any more")
        context.note("stream-silent", f"nothing came in the last {late_s:.1f} s", name)


def _note_tracking(name: str, stream: StreamHeader, context: Context) -> None:
    if times := context.events.frozen.get(name):
        text = f"the pose did not change for half a second or longer, {times} times"
        context.note("pose-frozen", text, name)
    if jumps := context.events.jumps.get((stream.device, stream.port.name)):
        text = f"the pose jumped {len(jumps)} times, by up to {max(jumps):.2f} m"
        context.note("pose-jumped", text, name)


def _note_damages(name: str, damages: list[Damage], context: Context, *, is_there: bool) -> None:
    if not damages:
        return
    known = sum(damage.lost or 0 for damage in damages)
    length = sum(damage.bytes for damage in damages)
    where = ", ".join(
        f"{damage.path.name} at {damage.offset} ({damage.what})"
        for damage in damages[:_DAMAGES_SHOWN]
    )
    more = len(damages) - _DAMAGES_SHOWN
    context.note(
        "journal-damaged",
        f"{length} bytes of the journal of {name} hold no whole record, {known} or more samples "
        f"are lost: {where}{f' and {more} more' if more > 0 else ''}",
        name if is_there else None,
    )


def _finish_losses(
    name: str,
    stream: StreamHeader,
    columns: Columns,
    losses: Losses,
    out: Any,
    context: Context,
) -> None:
    counted = context.events.lost_of(name)
    # What was dropped after the last sample leaves no hole.
    behind = counted.get("queue", 0) - losses.lost.get("queue", 0)
    if behind > 0 and not losses.lost.get("journal"):
        losses.gap(losses.count - 1, "the disk could not keep up", behind)
    if stream.device in context.events.gone:
        losses.gap(losses.count - 1, "the device was gone")
    _declare_silence(name, stream, columns, losses, context)
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
