"""A recorder: devices that run all the time, and episodes that are begun and ended meanwhile."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.model.episode import EpisodeMetadata
from exumi_recorders.contract import DeviceError, Event, Health, Sample
from exumi_recorders.finalise.clocks import utc_text
from exumi_recorders.finalise.events import DEVICE_LOST, FROZEN, STOPPED
from exumi_recorders.finalise.rehearsal import rehearse
from exumi_recorders.finalise.rows import payload_bytes_of
from exumi_recorders.journal.flusher import OnFlushed
from exumi_recorders.journal.header import (
    JournalHeader,
)
from exumi_recorders.journal.journal import JournalWriter, read_clock_pair
from exumi_recorders.journal.log import SEGMENT_BYTES
from exumi_recorders.journal.record import salt_of
from exumi_recorders.journal.space import Reserve, SpaceLimits, check_room
from exumi_recorders.recording.device import DeviceThread, RecordedDevice, RecordedStream
from exumi_recorders.recording.headers import boot_id, stream_header
from exumi_recorders.recording.lanes import Lane, Limits, Pressure
from exumi_recorders.recording.status import (
    DeviceStatus,
    Problem,
    RecordingStatus,
    StreamStatus,
)
from exumi_recorders.recording.watching import (
    MALFORMED,
    lost_since,
    problems_of_device,
    problems_of_stream,
    status_of,
)
from exumi_recorders.recording.writer import WriterThread

__all__ = ["STICKY", "Recorded", "Recorder"]

STICKY = ("world_frame", "controls", "clock")
"""Events that hold until the next one: an episode that begins later gets the last one."""

_OPEN_S = 30.0
_GRACE_S = 0.1


@dataclass(frozen=True, slots=True)
class Recorded:
    """An episode that was recorded, and waits to be finalised.

    Attributes
    ----------
    journal : pathlib.Path
    truncated : str or None
        Why it ended before it was stopped.
    samples, dropped : dict of str to int
        Of each stream.
    """

    journal: Path
    truncated: str | None
    samples: Mapping[str, int]
    dropped: Mapping[str, int]


@dataclass(slots=True)
class _Episode:
    id: str
    began_ns: int
    journal: JournalWriter
    writer: WriterThread
    lanes: dict[str, Lane]
    health: dict[str, Health]


class Recorder:
    """Read devices all the time; record episodes of them.

    Devices run from `open` to `close`. `start` and `stop` are for one thread; `status` and
    `latest_frame` for any.

    Parameters
    ----------
    devices : sequence of RecordedDevice
    on_event : callable, optional
        Told of each event (the device's name, the event) in the thread of the device: it has to
        return at once, and not to raise.
    limits : Limits, optional
        How much may wait for the disk.
    space : SpaceLimits, optional
        How much room the disk has to have.
    segment_bytes : int
    on_flushed : callable, optional
        For tests of power loss: told which segments are safe, and how far.

    Raises
    ------
    UsageError
        Two streams have one name.
    """

    def __init__(
        self,
        devices: Sequence[RecordedDevice],
        *,
        on_event: Callable[[str, Event], None] | None = None,
        limits: Limits | None = None,
        space: SpaceLimits | None = None,
        segment_bytes: int = SEGMENT_BYTES,
        on_flushed: OnFlushed | None = None,
    ) -> None:
        names = [name for device in devices for name in device.streams.values()]
        if len(set(names)) != len(names) or len({each.name for each in devices}) != len(devices):
            raise UsageError("two streams or two devices have one name")
        self._limits = limits or Limits()
        self._space = space or SpaceLimits()
        self._segment_bytes = segment_bytes
        self._on_flushed = on_flushed
        self.told = on_event
        self._pressure = Pressure(self._limits)
        self._sticky: dict[tuple[str, str], Event] = {}
        self._early: list[tuple[str, Event]] | None = None
        self._episode: _Episode | None = None
        self._reserve: Reserve | None = None
        self._truncated: str | None = None
        self._events_lock = threading.Lock()
        self._opened_ns = 0
        self._threads = [
            DeviceThread(
                device, on_event=self._take_event, wake=self._wake, has_room=self._has_room
            )
            for device in devices
        ]

    # ------------------------------------------------------------------------------------- devices

    def open(self) -> None:
        """Open all devices, at the same time; on failure none stays open.

        Raises
        ------
        DeviceError
            The first one that could not be opened.
        UsageError
            What a device delivers cannot be stored.
        """
        for thread in self._threads:
            thread.start()
        failures = {thread.name: thread.wait_until_open(_OPEN_S) for thread in self._threads}
        for name, failure in failures.items():
            if failure is not None:
                self.close()
                if isinstance(failure, DeviceError | ImportError):
                    raise failure
                raise DeviceError(f"cannot be opened: {failure}", where=name) from failure
        try:
            rehearse({name: stream_header(stream, {}) for name, stream in self.streams.items()})
        except BaseException:
            self.close()
            raise
        self._opened_ns = time.monotonic_ns()

    def close(self) -> None:
        """Stop recording, and close all devices; also a second time."""
        if self._episode is not None:
            self.stop()
        for thread in self._threads:
            thread.stop()
        if self._reserve is not None:
            self._reserve.leave()

    def __enter__(self) -> "Recorder":
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def streams(self) -> dict[str, RecordedStream]:
        """All streams by name, once the devices are open."""
        return {
            stream.name: stream for thread in self._threads for stream in thread.streams.values()
        }

    def latest_frame(self, stream: str) -> Sample | None:
        """Return the newest image of a camera, for a preview; older ones where the disk is slow.

        Parameters
        ----------
        stream : str
        """
        found = self.streams.get(stream)
        return None if found is None else found.latest

    # ------------------------------------------------------------------------------------ episodes

    def start(
        self,
        dataset: Path,
        metadata: EpisodeMetadata,
        *,
        arrays: Mapping[str, np.ndarray] | None = None,
    ) -> Path:
        """Begin an episode: when this returns, it is safe to say that it is being recorded.

        Parameters
        ----------
        dataset : pathlib.Path
        metadata : EpisodeMetadata
            Without streams; `start` is filled in. Items ``latency/<stream>`` of its calibration
            become the latencies of the streams' clocks.
        arrays : mapping of str to ndarray, optional
            Arrays of calibration items, by path below ``calibration/``.

        Returns
        -------
        pathlib.Path
            The journal.

        Raises
        ------
        UsageError
            One is being recorded, or a stream cannot be.
        NoRoomError
            The disk is nearly full.
        """
        if self._episode is not None:
            raise UsageError("an episode is being recorded")
        check_room(dataset, self._space)
        reserve = self._reserve_of(dataset)
        reserve.hold()
        monotonic, utc, _ = read_clock_pair()
        metadata = metadata.model_copy(deep=True)
        metadata.start = utc_text(utc)
        streams = self.streams
        header = JournalHeader(
            boot_id=boot_id(),
            t0_monotonic_ns=monotonic,
            episode=metadata,
            streams={
                name: stream_header(stream, metadata.calibration)
                for name, stream in streams.items()
            },
        )
        lanes = {name: self._lane(header, streams[name]) for name in streams}
        health = {thread.name: thread.health_now() for thread in self._threads}
        self._truncated = None
        with self._events_lock:
            # What happens from here on comes after this, and waits for the journal.
            early = self._early = self._held_events()
        self._pressure.lanes = tuple(lanes.values())
        for name, stream in streams.items():
            stream.lane = lanes[name]
        try:
            journal = JournalWriter(
                dataset,
                header,
                arrays=arrays,
                segment_bytes=self._segment_bytes,
                on_flushed=self._on_flushed,
            )
        except BaseException:
            self._early = None
            self._detach(lanes)
            self._pressure.lanes = ()
            raise
        writer = WriterThread(
            journal,
            list(lanes.values()),
            counters=self._counters,
            limits=self._space,
            reserve=reserve,
        )
        with self._events_lock:
            for device, event in early:
                writer.put_event(device, event)
            self._early = None
            self._episode = _Episode(metadata.id, monotonic, journal, writer, lanes, health)
        writer.start()
        return journal.path

    def _held_events(self) -> list[tuple[str, Event]]:
        """Return what an episode that begins now has to know of before."""
        now_ns = time.monotonic_ns()
        gone = [
            (thread.name, Event(DEVICE_LOST, now_ns, {"error": thread.trouble or ""}))
            for thread in self._threads
            if not thread.connected
        ]
        frozen = [
            (stream.device, Event(FROZEN, now_ns, {"stream": stream.name}))
            for stream in self.streams.values()
            if stream.frozen
        ]
        held = [(device, event) for (device, _), event in self._sticky.items()]
        return [*held, *gone, *frozen]

    def _reserve_of(self, dataset: Path) -> Reserve:
        """Return what is kept back on the dataset's disk, from one episode to the next."""
        reserve = self._reserve
        wanted = Reserve(dataset, self._space.reserve_bytes)
        if reserve is None or reserve.path != wanted.path:
            if reserve is not None:
                reserve.leave()
            reserve = self._reserve = wanted
        return reserve

    def _lane(self, header: JournalHeader, stream: RecordedStream) -> Lane:
        return Lane(
            stream.name,
            salt_of(header.episode.id, stream.name),
            self._pressure,
            droppable=stream.port.droppable,
            start_ns=header.t0_monotonic_ns,
            payload_bytes=payload_bytes_of(header.streams[stream.name]),
        )

    def stop(self) -> Recorded:
        """End the episode: what was stamped until now is recorded.

        Returns
        -------
        Recorded

        Raises
        ------
        UsageError
            None is being recorded.
        """
        episode = self._episode
        if episode is None:
            raise UsageError("no episode is being recorded")
        stop_ns = time.monotonic_ns()
        for lane in episode.lanes.values():
            lane.end_at(stop_ns)
        episode.writer.put_event("", Event(STOPPED, stop_ns))
        if episode.writer.truncated is None:
            time.sleep(_GRACE_S)  # what was stamped before may still be on its way
        self._detach(episode.lanes)
        episode.writer.stop()
        self._truncated = episode.writer.truncated
        with self._events_lock:
            self._episode = None
        self._pressure.lanes = ()
        return Recorded(
            episode.journal.path,
            episode.writer.truncated,
            {name: lane.written for name, lane in episode.lanes.items()},
            {name: lane.dropped for name, lane in episode.lanes.items()},
        )

    def _detach(self, lanes: Mapping[str, Lane]) -> None:
        for stream in self.streams.values():
            stream.lane = None
        for lane in lanes.values():
            lane.close()

    def add_event(self, name: str, **detail: Any) -> None:
        """Write an event of the recorder's user into the episode; nothing happens without one.

        Parameters
        ----------
        name : str
        **detail
            JSON values.
        """
        self._take_event("", Event(name, time.monotonic_ns(), detail), own=True)

    # --------------------------------------------------------------------------- what threads tell

    def _take_event(self, device: str, event: Event, *, own: bool = False) -> None:
        with self._events_lock:
            if event.name in STICKY:
                self._sticky[device, event.name] = event
            episode = self._episode
            if episode is not None:
                episode.writer.put_event(device, event)
            elif self._early is not None:
                self._early.append((device, event))
        told = self.told
        if told is not None and not own:
            told(device, event)

    def _wake(self) -> None:
        episode = self._episode
        if episode is not None:
            episode.writer.wake.set()

    def _has_room(self) -> bool:
        return self._pressure.share(time.monotonic_ns()) < self._limits.preview_share

    def _counters(self) -> dict[str, Any]:
        """Return what was lost so far in this episode, for its journal."""
        episode = self._episode
        if episode is None:
            return {}
        lost: dict[str, dict[str, int]] = {}
        sigmas: dict[str, float] = {}
        for thread in self._threads:
            health = thread.health_now()
            if health.stamp_sigma_ns is not None:
                sigmas[thread.name] = float(health.stamp_sigma_ns)
            for name, causes in lost_since(thread, health, episode.health[thread.name]).items():
                lost.setdefault(name, {}).update(causes)
        for name, lane in episode.lanes.items():
            for cause, number in (("queue", lane.dropped), (MALFORMED, lane.malformed)):
                if number:
                    lost.setdefault(name, {})[cause] = number
        return {"lost": lost, "stamp_sigma_ns": sigmas}

    # -------------------------------------------------------------------------------------- status

    def status(self) -> RecordingStatus:
        """Tell how the recording is going; cheap enough for ten times a second."""
        now_ns = time.monotonic_ns()
        episode = self._episode
        share = self._pressure.share(now_ns)
        problems: list[Problem] = []
        streams: list[StreamStatus] = []
        for thread in self._threads:
            problems += problems_of_device(thread)
            lost = (
                {}
                if episode is None
                else lost_since(thread, thread.health, episode.health[thread.name])
            )
            for stream in thread.streams.values():
                lane = None if episode is None else episode.lanes.get(stream.name)
                streams.append(status_of(stream, lane, lost.get(stream.name, {}), now_ns))
                problems += problems_of_stream(stream, thread, streams[-1], self._opened_ns, now_ns)
        problems += self._own_problems(episode, share)
        return RecordingStatus(
            recording=episode is not None and episode.writer.truncated is None,
            episode=None if episode is None else episode.id,
            elapsed_s=0.0 if episode is None else (now_ns - episode.began_ns) / 1e9,
            bytes=0 if episode is None else episode.journal.written_bytes,
            pressure=share,
            truncated=self._truncated if episode is None else episode.writer.truncated,
            free_bytes=-1 if episode is None else episode.writer.free_bytes,
            streams=tuple(streams),
            devices=tuple(
                DeviceStatus(
                    name=thread.name, connected=thread.connected, readings=thread.health.readings
                )
                for thread in self._threads
            ),
            problems=tuple(problems),
        )

    def _own_problems(self, episode: _Episode | None, share: float) -> list[Problem]:
        problems = []
        truncated = self._truncated if episode is None else episode.writer.truncated
        if truncated is not None:
            code = "disk_full" if truncated == "disk_full" else "disk_error"
            problems.append(Problem("", code, f"The recording was ended: {truncated}."))
        if share >= self._limits.warn_share:
            problems.append(Problem("", "disk_slow", "The disk cannot keep up."))
        return problems
