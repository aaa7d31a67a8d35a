"""A journal becomes an episode: written aside, read back, renamed, and only then dropped."""

import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from exumi_data.catalog import episode_path
from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError, ExumiError, UsageError
from exumi_data.model.base import STREAM_NAME
from exumi_data.model.description import CalibrationItem
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.files import sync_folder
from exumi_data.store.plain_files import is_plain_file
from exumi_data.store.zarr_document import DTYPES
from exumi_recorders.finalise.agreement import check_agreement, has_samples
from exumi_recorders.finalise.clocks import epoch_of
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.events import EventSummary, read_events
from exumi_recorders.finalise.headers import read_header
from exumi_recorders.finalise.rows import payload_bytes_of
from exumi_recorders.finalise.streams import finish_stream
from exumi_recorders.finalise.sync_early import synced_early
from exumi_recorders.finalise.touch import SESSION_REFERENCE
from exumi_recorders.finalise.verify import verify
from exumi_recorders.journal.header import (
    CLOCK_LOG,
    EVENTS_LOG,
    JournalHeader,
)
from exumi_recorders.journal.reading import Damage, LogReader
from exumi_recorders.journal.record import salt_of
from exumi_recorders.journal.states import (
    HEADER_NAME,
    RECORDING_FOLDER,
    REMOVED,
    SUFFIX,
    JournalState,
    locked,
    read_state,
    write_state,
)

__all__ = ["Finalised", "dataset_of", "finalise", "inspect"]

_MOST_ARRAY_BYTES = 256 << 20
_DAMAGES_SHOWN = 5

Outcome = Literal["finalised", "present", "discarded", "empty", "recording", "found"]


@dataclass(frozen=True, slots=True)
class Finalised:
    """What became of a journal.

    Attributes
    ----------
    journal : pathlib.Path
    outcome : str
        ``finalised``; ``present``: the episode was there already, what was left of the journal is
        gone; ``discarded``: it stays; ``empty``: nothing was ever recorded, it is gone;
        ``recording``: somebody holds it, it was left alone; ``found``: it was only looked at.
    episode : pathlib.Path or None
    samples : dict of str to int
        Of each stream.
    damages : tuple of Damage
    truncated : str or None
        Why recording ended before it was stopped.
    crashed : bool
        Whether the recorder ended without stopping.
    """

    journal: Path
    outcome: Outcome
    episode: Path | None = None
    samples: Mapping[str, int] | None = None
    damages: tuple[Damage, ...] = ()
    truncated: str | None = None
    crashed: bool = False


def dataset_of(journal: Path) -> Path:
    """Return the dataset that a journal's episode belongs to.

    Parameters
    ----------
    journal : pathlib.Path

    Raises
    ------
    UsageError
        It does not lie in the folder ``.recording`` of one.
    """
    parent = journal.absolute().parent
    if parent.name != RECORDING_FOLDER or not journal.name.endswith(SUFFIX):
        raise UsageError(
            f"is no journal in the folder {RECORDING_FOLDER} of a dataset",
            where=journal,
            fix=f"Journals are <dataset>/{RECORDING_FOLDER}/<episode id>{SUFFIX}.",
        )
    return parent.parent


def finalise(journal: Path) -> Finalised:
    """Make the episode of a journal, and drop the journal. A second run changes nothing.

    Parameters
    ----------
    journal : pathlib.Path

    Returns
    -------
    Finalised

    Raises
    ------
    ExumiError
        It cannot be finalised; it stays as it is.
    OSError
        The disk is full, or cannot be written.
    """
    target = dataset_of(journal) / episode_path(journal.name.removesuffix(SUFFIX))
    try:
        with locked(journal):
            return _finalise(journal, target)
    except BlockingIOError:
        return Finalised(journal, "recording")
    except FileNotFoundError:
        if journal.exists():
            raise
        return Finalised(journal, "present", _present(target))  # another one was faster


def _finalise(journal: Path, target: Path) -> Finalised:
    state = read_state(journal)
    if state.state == "discarded":
        return Finalised(journal, "discarded")
    present = _present(target)
    if present is not None:
        _drop(journal, state)
        return Finalised(journal, "present", present)
    if _is_empty(journal):
        _drop(journal, state)
        return Finalised(journal, "empty")
    header, damages = read_header(journal)
    check_agreement(journal, header)
    counts = _write(journal, header, state, target, damages)
    _drop(journal, state)
    return Finalised(
        journal,
        "finalised",
        target,
        counts,
        tuple(damages),
        state.truncated,
        state.state == "recording",
    )


def _is_empty(journal: Path) -> bool:
    """Whether nobody was told that this is being recorded: the header is written last."""
    return not os.path.lexists(journal / HEADER_NAME) and not has_samples(journal)


def inspect(journal: Path) -> Finalised:
    """Read a journal to its end, and write nothing.

    Parameters
    ----------
    journal : pathlib.Path

    Raises
    ------
    ExumiError
        It cannot be finalised.
    """
    target = dataset_of(journal) / episode_path(journal.name.removesuffix(SUFFIX))
    try:
        with locked(journal):
            state = read_state(journal)
            if state.state == "discarded":
                return Finalised(journal, "discarded")
            present = _present(target)
            if present is not None:
                return Finalised(journal, "present", present)
            if _is_empty(journal):
                return Finalised(journal, "empty")
            header, damages = read_header(journal)
            check_agreement(journal, header)
            counts = {}
            for name in header.streams:
                log = _log(journal, header, name)
                counts[name] = sum(len(block) for block in log)
                damages += log.damages
    except BlockingIOError:
        return Finalised(journal, "recording")
    return Finalised(
        journal,
        "found",
        target,
        counts,
        tuple(damages),
        state.truncated,
        state.state == "recording",
    )


def _present(target: Path) -> Path | None:
    """Return the episode, as a folder or packed, if it is there and complete."""
    for path in (target, target.with_name(f"{target.name}.zip")):
        if path.exists():
            try:
                with open_episode(path) as episode:
                    episode.check_complete()
            except ExumiError as error:
                raise DamagedDataError(
                    f"an episode is there, and is damaged: {error}",
                    where=path,
                    fix="Move it away, and recover again: the journal is kept.",
                ) from error
            return path
    return None


def _drop(journal: Path, state: JournalState) -> None:
    write_state(journal, state.model_copy(update={"state": "finalised"}))
    # Under another name, so that half of it is never taken for a journal.
    removed = journal.with_suffix(REMOVED)
    shutil.rmtree(removed, ignore_errors=True)
    journal.rename(removed)
    sync_folder(journal.parent)
    shutil.rmtree(removed, ignore_errors=True)


def _log(journal: Path, header: JournalHeader, name: str) -> LogReader:
    stream = header.streams.get(name)
    length = None if stream is None else payload_bytes_of(stream)
    return LogReader(journal / name, salt_of(header.episode.id, name), length)


def _write(
    journal: Path, header: JournalHeader, state: JournalState, target: Path, damages: list[Damage]
) -> dict[str, int]:
    beside = list(damages)  # of the header
    events_log, clock_log = (_log(journal, header, name) for name in (EVENTS_LOG, CLOCK_LOG))
    events = read_events(events_log)
    epoch = epoch_of(clock_log, header)
    metadata = header.episode.model_copy(deep=True)
    metadata.start = epoch.start
    said = events.success if state.success is None else state.success
    metadata.success = metadata.success if said is None else said
    arrays = _arrays(journal, metadata.calibration)
    counts: dict[str, int] = {}
    with EpisodeWriter(target, metadata, before_rename=partial(verify, counts=counts)) as writer:
        context = Context(writer, header.t0_monotonic_ns, events, arrays, counts)
        _copy_arrays(context)
        with synced_early(target.with_name(f".partial-{metadata.id}")):
            for name, stream in header.streams.items():
                log = _log(journal, header, name)
                finish_stream(name, stream, log, context)
                damages += log.damages
        found = [*events_log.damages, *clock_log.damages]
        beside += found
        damages += found
        if epoch.note is not None:
            writer.metadata.quality.append(epoch.note)
        _leave_notes(context, state)
        _note_damages_beside(context, journal, beside)
        _keep_events(context, events, header.boot_id)
    return counts


def _arrays(journal: Path, items: Mapping[str, CalibrationItem]) -> dict[str, np.ndarray]:
    """Open the arrays that calibration items name; one that cannot be read is left out."""
    found = {}
    for item in items.values():
        name = (item.array or "").removeprefix("calibration/")
        parts = name.split("/")
        if item.array is None or not all(re.fullmatch(STREAM_NAME, part) for part in parts):
            continue
        path = journal.joinpath("calibration", *parts[:-1], f"{parts[-1]}.npy")
        try:
            # Not a link, which could lead anywhere, nor a pipe, which would be waited for.
            if not is_plain_file(path) or path.stat().st_size > _MOST_ARRAY_BYTES:
                continue
            array = np.load(path, mmap_mode="r", allow_pickle=False)
            if array.dtype.name in DTYPES:
                found[name] = array
        except (OSError, ValueError, EOFError):
            continue
    return found


def _copy_arrays(context: Context) -> None:
    for name, item in list(context.calibration.items()):
        if item.array is None:
            continue
        if name.startswith(SESSION_REFERENCE):
            item.array = None  # it becomes the stream's own
            continue
        array = context.arrays.get(item.array.removeprefix("calibration/"))
        if array is None:
            del context.calibration[name]
            context.note("calibration-lost", f"the array of the calibration {name!r} is not there")
            continue
        path = item.array.removeprefix("calibration/")
        context.writer.add_calibration_array(path, array, dimension_names=_names(path, array))


def _names(path: str, array: np.ndarray) -> tuple[str, ...] | None:
    known = {"rectification": ("y", "x", "index"), "tactile_reference": ("y", "x", "c")}
    names = known.get(path.partition("/")[0])
    return names if names is not None and len(names) == array.ndim else None


def _leave_notes(context: Context, state: JournalState) -> None:
    if state.truncated is not None:
        context.note("truncated", f"{state.truncated}: the recording ended before it was stopped")
    if state.state == "recording":
        context.note(
            "recovered",
            "the recorder ended without stopping; what it had written was recovered",
            info=True,
        )
    for device, times in context.events.losses.items():
        context.note("device-lost", f"{device} was gone {times} times")


def _note_damages_beside(context: Context, journal: Path, damages: list[Damage]) -> None:
    if not damages:
        return
    where = ", ".join(
        f"{damage.path.relative_to(journal)} at {damage.offset} ({damage.what})"
        for damage in damages[:_DAMAGES_SHOWN]
    )
    more = len(damages) - _DAMAGES_SHOWN
    context.note(
        "journal-damaged",
        f"what the journal holds beside samples is damaged: {where}"
        f"{f' and {more} more' if more > 0 else ''}",
    )


def _keep_events(context: Context, events: EventSummary, boot_id: str) -> None:
    """Keep what happened beside the samples with the episode's source: the journal goes."""
    source = context.writer.metadata.source
    settings = {**(source.settings or {}), "boot_id": boot_id}
    if events.kept:
        settings["events"] = [
            {"time_ns": time_ns - context.t0_ns, "device": device, "name": name, "detail": detail}
            for time_ns, device, name, detail in events.kept
        ]
    if events.unkept:
        settings["events_left_out"] = events.unkept
    source.settings = settings
