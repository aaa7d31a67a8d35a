"""One episode as one recording."""

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr
import rerun_bindings

from exumi_data.episode import Episode, StreamView
from exumi_data.errors import DamagedDataError, LimitError, MetadataError, UnsupportedError
from exumi_data.view.about import log_about
from exumi_data.view.curves import log_audio, log_numbers, log_width, log_wrench
from exumi_data.view.events import log_episode_events, stream_events
from exumi_data.view.log import Event, Log
from exumi_data.view.names import ViewOptions, recording_name
from exumi_data.view.panels import Panel
from exumi_data.view.pictures import log_pictures
from exumi_data.view.report import EpisodeView
from exumi_data.view.space import camera_path, log_opening, log_pose
from exumi_data.view.tactile import log_tactile
from exumi_data.view.taxels import log_taxels
from exumi_data.view.times import timelines_of

__all__ = ["record_episode", "streams_of"]

_ROOM_BYTES = 64 << 20
"""More than is written between two looks at the disk. On a full one Rerun waits for ever, deaf to
signals, so it must not get there."""


def streams_of(episode: Episode, options: ViewOptions) -> list[StreamView]:
    """Return the streams of an episode that are shown."""
    wanted = options.streams
    return [one for name, one in episode.streams.items() if not wanted or name in wanted]


def record_episode(
    episode: Episode,
    path: Path,
    application: str,
    options: ViewOptions,
    on_samples: Callable[[int], None],
) -> tuple[EpisodeView, dict[Panel, int]]:
    """Write an episode's recording into a file of its own.

    Parameters
    ----------
    episode : Episode
    path : pathlib.Path
        Of the file, ``.rrd``.
    application : str
        Rerun's application id.
    options : ViewOptions
    on_samples : callable
        Told how many samples are done since the last time.

    Returns
    -------
    EpisodeView, dict of Panel to int
        What became of it; what it shows, and how often.

    Raises
    ------
    OSError
        The disk is nearly full.
    """

    def counted(samples: int) -> None:
        _check_room(path)
        on_samples(samples)

    _check_room(path)
    try:
        return _record(episode, path, application, options, counted)
    finally:
        # Rerun keeps threads and the last block of each recording that is gone, until it is told.
        rerun_bindings.flush_and_cleanup_orphaned_recordings()


def _check_room(path: Path) -> None:
    if shutil.disk_usage(path.parent).free < _ROOM_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path.parent))


def _record(
    episode: Episode,
    path: Path,
    application: str,
    options: ViewOptions,
    on_samples: Callable[[int], None],
) -> tuple[EpisodeView, dict[Panel, int]]:
    name = recording_name(episode)
    recording = rr.RecordingStream(application, recording_id=episode.id, send_properties=False)
    try:
        # The same episode gives the same recording, whenever it is written.
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        recording.save(path)
        recording.send_recording_name(name)
        timelines = timelines_of(episode)
        if timelines.start_ns is not None:
            recording.send_recording_start_time_nanos(timelines.start_ns)
        log = Log(recording, timelines, on_samples)
        _log_episode(log, episode, options)
        recording.flush()
    finally:
        recording.disconnect()
    view = EpisodeView(
        id=episode.id, name=name, samples=log.samples, faults=log.faults, notes=tuple(log.notes)
    )
    return view, log.panels


def _log_episode(log: Log, episode: Episode, options: ViewOptions) -> None:
    streams = streams_of(episode, options)
    log_about(log, episode)
    for stream in streams:
        events: list[Event] = []
        try:
            _check_time(stream)
            events += _log_stream(log, episode, stream, options)
            log.samples[stream.name] = len(stream)
            events += stream_events(stream)
        except (DamagedDataError, LimitError, MetadataError, UnsupportedError) as error:
            log.fault(stream.name, error)
            events.append(Event(0, f"{stream.name} cannot be read: {error.reason}", "ERROR"))
        log.events(stream.name, events)
    _log_openings(log, episode, streams)
    log_episode_events(log, episode)


def _check_time(stream: StreamView) -> None:
    """Refuse times that go backwards: Rerun would put them in order, and nobody would see it."""
    wrong = np.flatnonzero(stream.time[1:] <= stream.time[:-1])
    if len(wrong):
        raise DamagedDataError(f"`time` does not increase strictly, at sample {wrong[0] + 1}")


def _log_stream(
    log: Log, episode: Episode, stream: StreamView, options: ViewOptions
) -> list[Event]:
    """Log a stream; return the frames that are missing."""
    if stream.kind == "tactile":
        return log_tactile(log, episode, stream, options)
    if stream.is_image:
        path = camera_path(log, episode, stream) or f"/camera/{stream.name}"
        events = log_pictures(log, stream, path, options)
        log.place(Panel("camera", path, stream.name))
        return events
    numbers = {"width": log_width, "wrench": log_wrench, "taxels": log_taxels, "audio": log_audio}
    if stream.kind == "pose":
        log_pose(log, episode, stream)
    elif stream.kind in numbers:
        numbers[stream.kind](log, stream)
    elif not log_numbers(log, stream):
        log.notes.append(f"{stream.name}: nothing of kind {stream.kind} can be drawn")
    return []


def _log_openings(log: Log, episode: Episode, streams: list[StreamView]) -> None:
    """Log the opening of each gripper whose pose is known."""
    poses = [stream for stream in streams if stream.kind == "pose"]
    widths = [stream for stream in streams if stream.kind == "width"]
    for pose in poses:
        width = _partner(pose, poses, widths)
        if width is not None and {pose.name, width.name} <= log.samples.keys():
            log_opening(log, episode, pose, width)


def _partner(
    pose: StreamView, poses: list[StreamView], widths: list[StreamView]
) -> StreamView | None:
    """Return the width of a pose's gripper: the only one, or the one whose name ends alike."""
    if len(poses) == len(widths) == 1:
        return widths[0]
    ending = pose.name.rpartition("_")[2]
    alike = [width for width in widths if width.name.rpartition("_")[2] == ending]
    return alike[0] if len(alike) == 1 else None
