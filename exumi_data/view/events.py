"""What happened: segments, gaps, flags, lost samples; and what is said of the quality."""

import numpy as np
import rerun as rr

from exumi_data.episode import Episode, StreamView
from exumi_data.model.description import Segment
from exumi_data.standard.registry import flags as registered_flags
from exumi_data.view.log import Event, Log
from exumi_data.view.names import SEGMENTS
from exumi_data.view.panels import Panel

__all__ = ["log_episode_events", "stream_events"]

_LANES = ((71, 85, 105), (13, 148, 136), (180, 83, 9), (109, 40, 217), (190, 24, 93), (3, 105, 161))
"""Colours of segments, dark enough for white letters."""
_NOTHING = ""
"""Ends a state without another one."""


def stream_events(stream: StreamView) -> list[Event]:
    """Return the gaps of a stream and the runs of samples that have a flag.

    Parameters
    ----------
    stream : StreamView

    Returns
    -------
    list of Event
    """
    return [*_gaps(stream), *_flag_runs(stream)]


def _gaps(stream: StreamView) -> list[Event]:
    events = []
    for gap in stream.metadata.gaps or []:
        position = gap.after + 1
        if not 0 <= position < len(stream):
            continue
        lost = "samples" if gap.lost is None else f"{gap.lost:,} samples"
        reason = f": {gap.reason}" if gap.reason else ""
        text = f"{stream.name}: {lost} missing before {position}{reason}"
        events.append(Event(int(stream.time[position]), text, "WARN"))
    return events


def _flag_runs(stream: StreamView) -> list[Event]:
    flags = stream.flags
    if flags is None or not flags.any():
        return []
    listed = {gap.after + 1 for gap in stream.metadata.gaps or []}
    events = []
    for flag in registered_flags().values():
        rows = np.flatnonzero(flags & np.uint32(flag.mask))
        if flag.name == "gap_before":
            rows = rows[~np.isin(rows, list(listed))]
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if len(run):
                first, last = int(run[0]), int(run[-1])
                which = f"sample {first}" if first == last else f"samples {first} to {last}"
                text = f"{stream.name}: {flag.name}, {which}"
                level = "INFO" if flag.name == "time_nudged" else "WARN"
                events.append(Event(int(stream.time[first]), text, level))
    return events


def log_episode_events(log: Log, episode: Episode) -> None:
    """Log the segments of an episode, as lanes and as events.

    Parameters
    ----------
    log : Log
    episode : Episode
    """
    said = episode.metadata.annotations
    segments = (said.segments if said else None) or []
    events = []
    for segment in segments:
        events.append(Event(segment.start_ns, f"{segment.name} begins", "INFO"))
        events.append(Event(segment.end_ns, f"{segment.name} ends", "INFO"))
    log.events("segments", events)
    names = list(dict.fromkeys(segment.name for segment in segments))
    colours = [_LANES[number % len(_LANES)] for number in range(len(names))]
    for number, lane in enumerate(_lanes(segments)):
        path = f"{SEGMENTS}/{number}"
        log.fixed(path, rr.StateConfiguration(values=names, colors=colours))
        _log_lane(log, path, lane)
    if segments:
        log.place(Panel("segments", SEGMENTS, "Segments"))


def _lanes(segments: list[Segment]) -> list[list[Segment]]:
    """Put segments into lanes, so that those of one lane do not overlap."""
    lanes: list[list[Segment]] = []
    for segment in sorted(segments, key=lambda one: (one.start_ns, one.end_ns)):
        for lane in lanes:
            if lane[-1].end_ns <= segment.start_ns:
                lane.append(segment)
                break
        else:
            lanes.append([segment])
    return lanes


def _log_lane(log: Log, path: str, lane: list[Segment]) -> None:
    states = {segment.end_ns: _NOTHING for segment in lane}
    # A segment that begins where another ends takes its place.
    states |= {segment.start_ns: segment.name for segment in lane}
    times = sorted(states)
    columns = rr.StateChange.columns(state=[states[time_ns] for time_ns in times])
    log.rows(path, np.array(times, np.int64), columns)
