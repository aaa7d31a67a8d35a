"""What is said between a session and the one who runs it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from exumi_recorders.recording.status import RecordingStatus
from exumi_recorders.session.finishing import Finished

__all__ = [
    "COMMANDS",
    "Command",
    "CommandName",
    "Message",
    "SessionReport",
    "SessionStatus",
    "State",
]

CommandName = Literal[
    "start",
    "stop",
    "toggle",
    "discard",
    "reason",
    "undo",
    "success",
    "failure",
    "reference",
    "quit",
]
COMMANDS: tuple[CommandName, ...] = get_args(CommandName)
"""All of them."""
State = Literal["waiting", "recording", "ended"]


@dataclass(frozen=True, slots=True)
class Command:
    """What somebody wants of a session.

    Attributes
    ----------
    name : str
        ``start``, ``stop``, ``toggle``, ``discard``, ``reason``, ``undo``, ``success``,
        ``failure``, ``reference``, ``quit``.
    reason : str
        Of a discard; for ``reason``, also the number of one of the rig file's.
    """

    name: CommandName
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Message:
    """Something that happened, for the operator.

    Attributes
    ----------
    level : {"info", "warning", "error"}
    code, text : str
    episode : str, optional
        Its id, or the path of what was finished.
    """

    level: Literal["info", "warning", "error"]
    code: str
    text: str
    episode: str | None = None


@dataclass(frozen=True, slots=True)
class SessionStatus:
    """How a session is.

    Attributes
    ----------
    state : {"waiting", "recording", "ended"}
    recording : RecordingStatus
    kept, discarded : int
        Episodes so far.
    finishing : int
        Journals that are not episodes yet.
    undecided : bool
        The last episode can still be discarded.
    disk_minutes : float
        For which there is room.
    next_trial : int or None
        Of a touch that is labelled.
    widths_m : mapping of str to float
        How wide grippers are now, by stream, where that is known.
    """

    state: State
    recording: RecordingStatus
    kept: int
    discarded: int
    finishing: int
    undecided: bool
    disk_minutes: float
    next_trial: int | None
    widths_m: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class SessionReport:
    """What a session made.

    Attributes
    ----------
    finished : list of Finished
    discarded : list of pathlib.Path
        Journals that are tombstones now.
    left : list of pathlib.Path
        Journals that are not finished: ``exumi recover`` does it.
    not_started : str or None
        Why the session ended: an episode that was to begin by itself could not.
    """

    finished: list[Finished] = field(default_factory=list)
    discarded: list[Path] = field(default_factory=list)
    left: list[Path] = field(default_factory=list)
    not_started: str | None = None

    @property
    def problems(self) -> list[str]:
        """What went wrong, in a sentence each."""
        said = [f"{one.journal}: {one.problem}" for one in self.finished if one.problem]
        return said if self.not_started is None else [self.not_started, *said]
