"""What things are called in a view: timelines, entities, recordings."""

from dataclasses import dataclass

from exumi_data.episode import Episode

__all__ = [
    "ABOUT",
    "ACTIVITY",
    "EVENTS",
    "SEGMENTS",
    "TIME",
    "UTC",
    "ViewOptions",
    "recording_name",
]

TIME = "time"
"""Timeline of nanoseconds since the episode's start."""
UTC = "utc"
"""Timeline of the time of day, where the episode's start is known."""

ABOUT = "/about"
ACTIVITY = "/activity"
EVENTS = "/events"
SEGMENTS = "/segments"


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """What of an episode is shown, and how.

    Attributes
    ----------
    streams : tuple of str
        Names of streams; none stands for all.
    decode_video : bool
        Show video as decoded frames, also where the viewer could decode it itself.
    """

    streams: tuple[str, ...] = ()
    decode_video: bool = False


def recording_name(episode: Episode) -> str:
    """Return the name of an episode's recording: what was touched, task, id.

    What tells recordings apart comes first: viewers cut long names off.
    """
    meta = episode.metadata
    said = meta.annotations
    touched = (said.part_id or said.object_id or said.object) if said else None
    if touched and said and said.trial is not None:
        touched = f"{touched} {said.trial}"
    return " · ".join(part for part in (touched, meta.task.name, meta.id) if part)
