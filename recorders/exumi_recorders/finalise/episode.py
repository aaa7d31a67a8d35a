"""A journal becomes an episode: written aside, read back, renamed, and only then dropped."""

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
from exumi_data.store.plain_files import read_plain
from exumi_recorders.finalise.clocks import epoch_of
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.events import EventSummary, read_events
from exumi_recorders.finalise.pipeline import synced_early
from exumi_recorders.finalise.rows import payload_bytes_of
from exumi_recorders.finalise.streams import finish_stream
from exumi_recorders.finalise.touch import SESSION_REFERENCE
from exumi_recorders.finalise.verify import verify
from exumi_recorders.journal.header import (
    CLOCK_LOG,
    EVENTS_LOG,
    JournalHeader,
    parse_header,
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

_MOST_HEADER_BYTES = 32 << 20
_MOST_ARRAY_BYTES = 256 << 20

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
    if not (journal / HEADER_NAME).exists():
        # The header is written last: nobody was told that it is being recorded.
        if any(entry.stat().st_size for entry in journal.glob("*/*.log")):
            raise DamagedDataError("has samples, but no header.json", where=journal)
        _drop(journal, state)
        return Finalised(journal, "empty")
    header = read_header(journal)
    damages: list[Damage] = []
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


def read_header(journal: Path) -> JournalHeader:
    """Read a journal's header, and check that it is this journal's.

    Parameters
    ----------
    journal : pathlib.Path

    Raises
    ------
    ExumiError
        It is none, or of another journal.
    """
    path = journal / HEADER_NAME
    header = parse_header(read_plain(path, _MOST_HEADER_BYTES), path)
    if f"{header.episode.id}{SUFFIX}" != journal.name:
        raise DamagedDataError(f"the header is that of {header.episode.id}", where=journal)
    return header


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
            header = read_header(journal)
            counts, damages = {}, []
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
        damages += [*events_log.damages, *clock_log.damages]
        if epoch.note is not None:
            writer.metadata.quality.append(epoch.note)
        _leave_notes(context, state)
        _keep_events(context, events)
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
            if path.is_symlink() or path.stat().st_size > _MOST_ARRAY_BYTES:
                continue
            found[name] = np.load(path, mmap_mode="r", allow_pickle=False)
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


def _keep_events(context: Context, events: EventSummary) -> None:
    """Keep what happened beside the samples with the episode's source: the journal goes."""
    if not events.kept:
        return
    source = context.writer.metadata.source
    settings = dict(source.settings or {})
    settings["events"] = [
        {"time_ns": time_ns - context.t0_ns, "device": device, "name": name, "detail": detail}
        for time_ns, device, name, detail in events.kept
    ]
    if events.unkept:
        settings["events_left_out"] = events.unkept
    source.settings = settings
