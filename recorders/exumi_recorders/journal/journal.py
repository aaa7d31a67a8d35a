"""A journal that is being recorded: header, state, a log for each stream, events and clock."""

import json
import os
import re
import shutil
import struct
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from exumi_data.errors import EpisodeExistsError, UsageError
from exumi_data.model.base import STREAM_NAME
from exumi_data.store.files import sync_folder, try_lock, write_atomic
from exumi_recorders.contract import Event
from exumi_recorders.journal.flusher import FLUSH_PERIOD_S, Flusher, OnFlushed
from exumi_recorders.journal.header import CLOCK_LOG, EVENTS_LOG, HEADER_LOG, JournalHeader
from exumi_recorders.journal.log import SEGMENT_BYTES, LogWriter
from exumi_recorders.journal.record import NONE, pack_header, salt_of
from exumi_recorders.journal.states import (
    HEADER_NAME,
    JournalState,
    journal_folder,
    write_state,
)

__all__ = ["CLOCK_PAIR", "JournalWriter", "read_clock_pair"]

CLOCK_PAIR = struct.Struct("<qq")
"""Payload of the clock's log: UTC in ns since 1970, and the width of the bracket around it."""


def read_clock_pair() -> tuple[int, int, int]:
    """Return CLOCK_MONOTONIC, UTC, and how far apart they were read at most, all in ns."""
    before = time.monotonic_ns()
    utc = time.time_ns()
    after = time.monotonic_ns()
    return (before + after) // 2, utc, after - before


class _Numbered:
    """A log, and the numbers of its records."""

    def __init__(self, writer: LogWriter, salt: int) -> None:
        self.writer = writer
        self.salt = salt
        self.seq = 0


class JournalWriter:
    """Write a journal. It is durable when the constructor returns: "recording" may be shown.

    `append`, `append_event` and `append_clock` are for one thread.

    Parameters
    ----------
    dataset : pathlib.Path
    header : JournalHeader
    arrays : mapping of str to ndarray, optional
        Arrays of calibration items, by the item's `array` without ``calibration/``.
    segment_bytes : int
    flush_period_s : float
    on_flushed : callable, optional
        For tests of power loss.

    Attributes
    ----------
    path : pathlib.Path
        The journal's folder.
    header : JournalHeader

    Raises
    ------
    EpisodeExistsError
        There is a journal of this episode.
    OSError
        It cannot be written.
    """

    def __init__(
        self,
        dataset: Path,
        header: JournalHeader,
        *,
        arrays: Mapping[str, np.ndarray] | None = None,
        segment_bytes: int = SEGMENT_BYTES,
        flush_period_s: float = FLUSH_PERIOD_S,
        on_flushed: OnFlushed | None = None,
    ) -> None:
        self.header = header
        self.path = journal_folder(dataset, header.episode.id)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self.path.mkdir()
        except FileExistsError:
            raise EpisodeExistsError("a journal is there already", where=self.path) from None
        self._lock = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try_lock(self._lock)
        self._logs: dict[str, _Numbered] = {}
        self._flusher: Flusher | None = None
        try:
            for name, values in (arrays or {}).items():
                _write_array(self.path / "calibration", name, values)
            for name in (*header.streams, EVENTS_LOG, CLOCK_LOG):
                log = LogWriter(self.path / name, segment_bytes=segment_bytes)
                self._logs[name] = _Numbered(log, salt_of(header.episode.id, name))
            write_state(self.path, JournalState(state="recording"))
            raw = header.to_json()
            _write_copy(self.path / HEADER_LOG, header.episode.id, raw)
            # Last: a journal without a header was never shown as recording.
            write_atomic(self.path / HEADER_NAME, raw)
            for folder in (self.path, self.path.parent, dataset):
                sync_folder(folder)
            self._flusher = Flusher(
                [log.writer for log in self._logs.values()],
                period_s=flush_period_s,
                on_flushed=on_flushed,
            )
            self.append_clock()
        except BaseException:
            # Nobody was told that it is being recorded.
            self.abandon()
            shutil.rmtree(self.path, ignore_errors=True)
            raise

    @property
    def written_bytes(self) -> int:
        """What was written, of all logs."""
        return sum(log.writer.bytes for log in self._logs.values())

    def records(self, stream: str) -> int:
        """Return how many records of a stream were written.

        Parameters
        ----------
        stream : str
        """
        return self._logs[stream].writer.records

    @property
    def flush_error(self) -> OSError | None:
        """What the disk reported when the journal was to be made durable."""
        return None if self._flusher is None else self._flusher.error

    def append(self, stream: str, pieces: Sequence[bytes]) -> None:
        """Write records.

        Parameters
        ----------
        stream : str
        pieces : sequence of bytes
            Header, payload, header, payload ...; headers are made with the salt of this log.

        Raises
        ------
        OSError
            Not all could be written; whole records were.
        """
        self._logs[stream].writer.append(pieces)

    def append_event(self, device: str, event: Event) -> None:
        """Write an event.

        Parameters
        ----------
        device : str
            Who says it; empty for the recorder itself.
        event : Event
        """
        document = {"name": event.name, "device": device, "detail": dict(event.detail)}
        payload = json.dumps(document, default=str).encode()
        self._append_own(EVENTS_LOG, event.time_host_ns, payload)

    def append_clock(self) -> None:
        """Write what the clocks say now."""
        monotonic, utc, width = read_clock_pair()
        self._append_own(CLOCK_LOG, monotonic, CLOCK_PAIR.pack(utc, width))

    def _append_own(self, name: str, time_ns: int, payload: bytes) -> None:
        log = self._logs[name]
        header = pack_header(log.salt, log.seq, time_ns, NONE, NONE, 0, payload)
        log.writer.append((header, payload))
        log.seq += 1

    def stop(self, *, truncated: str | None = None) -> None:
        """Close the journal: it can be finalised when this returns.

        Parameters
        ----------
        truncated : str, optional
            Why it ended before it was stopped.

        Raises
        ------
        OSError
            The disk reports that something was not written, and `truncated` does not say so: call
            it again with the reason, or `abandon`.
        """
        if self._lock < 0:
            return
        error = self._close_all()
        if error is not None and truncated is None:
            raise error
        write_state(self.path, JournalState(state="stopped", truncated=truncated))
        self._unlock()

    def abandon(self) -> None:
        """Close what is open, and leave the state as it is: the journal can be recovered."""
        self._close_all()
        self._unlock()

    def _close_all(self) -> OSError | None:
        """Close all logs, also a second time; return the last thing that the disk reported."""
        found = None
        if self._flusher is not None:
            self._flusher.stop()
            found = self._flusher.error
        for log in self._logs.values():
            try:
                flushed = log.writer.close()
            except OSError as error:
                found = error
                continue
            if self._flusher is not None:
                self._flusher.tell(flushed)
        return found

    def _unlock(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def _write_copy(folder: Path, episode_id: str, raw: bytes) -> None:
    """Write the header as the one record of a log of its own."""
    log = LogWriter(folder)
    log.append((pack_header(salt_of(episode_id, HEADER_LOG), 0, 0, NONE, NONE, 0, raw), raw))
    log.close()


def _write_array(folder: Path, name: str, values: np.ndarray) -> None:
    parts = name.split("/")
    if not all(re.fullmatch(STREAM_NAME, part) for part in parts):
        raise UsageError(f"{name!r} is no name of a calibration array")
    path = folder.joinpath(*parts[:-1], f"{parts[-1]}.npy")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("xb") as file:
        np.save(file, values, allow_pickle=False)
        file.flush()
        os.fsync(file.fileno())
    for parent in path.parents:
        sync_folder(parent)
        if parent == folder:
            break
