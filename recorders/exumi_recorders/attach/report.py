"""What `attach` reports: every clip, and what of the session has none."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

__all__ = ["AttachReport", "ClipReport", "MissingReport", "Status"]

Status = Literal["attached", "present", "placed", "refused", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipReport:
    """What became of one clip.

    Attributes
    ----------
    name : str
    status : {"attached", "present", "placed", "refused", "failed"}
        ``present``: its episode was there already, complete and the same. ``placed``: in a dry
        run, it would be attached. ``refused``: its place is not certain. ``failed``: it cannot be
        read, or its episode not be written.
    duration_s : float
    session : str or None
        Id of the session that it belongs to.
    episode : str or None
        Id of its episode.
    start_s : float or None
        First frame, seconds of the session.
    sigma_s : float or None
        Standard deviation of that.
    drift_ppm : float or None
    correlation : float or None
        Of the camera's turning with the hand's.
    doubts : tuple of str
        Of its place.
    notes : tuple of str
        What else is to be known of its episode, such as frames that are missing. Not looked for in
        a dry run.
    reason : str
        Why it was not attached.
    """

    name: str
    status: Status
    duration_s: float = 0.0
    session: str | None = None
    episode: str | None = None
    start_s: float | None = None
    sigma_s: float | None = None
    drift_ppm: float | None = None
    correlation: float | None = None
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    reason: str = ""


@dataclass(frozen=True, slots=True)
class MissingReport:
    """A stretch of a session in which the hand was at work and of which there is no clip."""

    session: str
    start_s: float
    stop_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachReport:
    """What `exumi_recorders.attach.attach` did.

    Attributes
    ----------
    destination : str
    sessions : tuple of str
        Their ids.
    clips : tuple of ClipReport
        In the order of their names.
    missing : tuple of MissingReport
    notices : tuple of str
    dry_run : bool
    seconds : float
    """

    destination: str
    sessions: tuple[str, ...]
    clips: tuple[ClipReport, ...]
    missing: tuple[MissingReport, ...]
    notices: tuple[str, ...]
    dry_run: bool
    seconds: float

    @property
    def left_out(self) -> tuple[ClipReport, ...]:
        """The clips that have no episode."""
        return tuple(clip for clip in self.clips if clip.status in ("refused", "failed"))

    def to_json(self) -> dict[str, Any]:
        """Return the report as a JSON object."""
        return asdict(self)
