"""What became of a view: which episodes it shows, and what could not be shown."""

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["EpisodeView", "Fault", "Unreadable", "ViewReport"]


@dataclass(frozen=True, slots=True)
class Fault:
    """Something of a stream that is damaged, and therefore missing from the view.

    Attributes
    ----------
    stream : str
    count : int
        Frames that could not be read; 0 where it is about the stream itself.
    reason : str
        Of the first.
    """

    stream: str
    count: int
    reason: str


@dataclass(frozen=True, slots=True)
class EpisodeView:
    """One episode in a view.

    Attributes
    ----------
    id : str
    name : str
        Of its recording, as the viewer lists it.
    samples : dict of str to int
        How many samples of each stream are shown.
    faults : tuple of Fault
    notes : tuple of str
        What else a user should know, such as how video is shown.
    """

    id: str
    name: str
    samples: dict[str, int]
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Unreadable:
    """An episode that could not be opened.

    Attributes
    ----------
    id, reason : str
    """

    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class ViewReport:
    """What a view shows.

    Attributes
    ----------
    application : str
        Rerun's application id: all recordings of it share one layout.
    episodes : tuple of EpisodeView
    unreadable : tuple of Unreadable
    available : int
        Episodes that could have been shown.
    bytes : int
        Of the file.
    seconds : float
        It took to write.
    """

    application: str
    episodes: tuple[EpisodeView, ...]
    unreadable: tuple[Unreadable, ...]
    available: int
    bytes: int
    seconds: float

    @property
    def is_damaged(self) -> bool:
        """Whether something is missing because it is damaged."""
        return bool(self.unreadable) or any(episode.faults for episode in self.episodes)

    def to_json(self) -> dict[str, Any]:
        """Return the report as a JSON document."""
        return asdict(self)
