"""One stream of a journal becomes one stream of an episode; memory stays at a block."""

from typing import Any

from exumi_data.model.description import LossyStep
from exumi_recorders.contract import Rows
from exumi_recorders.finalise.clocks import clock_of
from exumi_recorders.finalise.columns import Columns
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.files import write_files
from exumi_recorders.finalise.losses import MOST_GAPS, Losses
from exumi_recorders.finalise.pipeline import ahead
from exumi_recorders.finalise.rows import write_rows
from exumi_recorders.journal.header import StreamHeader, port_of
from exumi_recorders.journal.reading import Damage, LogReader

__all__ = ["finish_stream"]

_DAMAGES_SHOWN = 5


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
    _finish_losses(name, stream, losses, out, context)
    if port.lossy is not None:
        source = context.writer.metadata.source
        step = LossyStep(step="jpeg-encode", stream=name, detail=port.lossy)
        source.lossy = [*(source.lossy or []), step]


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
