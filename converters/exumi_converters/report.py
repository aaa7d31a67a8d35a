"""What a run reports: while it goes on, and at its end."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from exumi_converters.exporter import Loss

__all__ = [
    "ConversionPlan",
    "ConversionReport",
    "ExportReport",
    "Failure",
    "Flag",
    "PrepareReport",
    "Progress",
]


@dataclass(frozen=True, slots=True)
class Progress:
    """Told after each episode.

    Attributes
    ----------
    done, total : int
        Episodes.
    name : str
        The one that was just done.
    status : {"converted", "skipped", "failed"}
    frames : int
        Frames written so far.
    seconds : float
        Since the run began.
    """

    done: int
    total: int
    name: str
    status: Literal["converted", "skipped", "failed"]
    frames: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Flag:
    """A quality note of an episode.

    Attributes
    ----------
    name : str
        Which part of the source the episode is.
    code : str
        Such as ``truncated``.
    message : str
    severity : {"info", "warning"}
    """

    name: str
    code: str
    message: str
    severity: Literal["info", "warning"]


@dataclass(frozen=True, slots=True)
class Failure:
    """An episode that could not be made, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _RunReport:
    """What both kinds of runs report.

    Attributes
    ----------
    source, destination : str
    total : int
        Episodes of the source: ``converted + skipped + len(failed)``.
    converted : int
        Episodes written by this run.
    skipped : int
        Episodes that were there already, complete and made from the same bytes and settings.
    flagged : tuple of Flag
        Quality notes of all episodes, also of skipped ones.
    failed : tuple of Failure
    notices : tuple of str
        What else the user should know.
    unexplained : tuple of str
        Episodes of the destination that this source does not explain; they were left alone.
    frames : int
        Frames written by this run.
    seconds : float
        Duration of the run.
    """

    source: str
    destination: str
    total: int
    converted: int
    skipped: int
    flagged: tuple[Flag, ...]
    failed: tuple[Failure, ...]
    notices: tuple[str, ...]
    unexplained: tuple[str, ...]
    frames: int
    seconds: float

    @property
    def complete(self) -> bool:
        """Whether nothing failed."""
        return not self.failed

    def to_json(self) -> dict[str, Any]:
        """Return the report as a JSON object."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConversionReport(_RunReport):
    """What `exumi_converters.convert` did.

    Attributes
    ----------
    converter : str
        Name and version.
    layout : str
        Which layout of the format was recognised, and by what.
    """

    converter: str
    layout: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ConversionPlan:
    """What a conversion would do.

    Attributes
    ----------
    source : str
    converter : str
        Name and version.
    layout : str
        Which layout of the format was recognised, and by what.
    episodes : tuple of str
        Keys of the episodes that would be written.
    failed : tuple of Failure
        Episodes that are there and cannot be converted, as far as names and headers tell.
    keeps, loses : tuple of str
        What of the source would be in the episodes, and what not.
    notices : tuple of str
    estimated_bytes : int
        How big the episodes would be, roughly.
    """

    source: str
    converter: str
    layout: str
    episodes: tuple[str, ...]
    failed: tuple[Failure, ...]
    keeps: tuple[str, ...]
    loses: tuple[str, ...]
    notices: tuple[str, ...]
    estimated_bytes: int

    def to_json(self) -> dict[str, Any]:
        """Return the plan as a JSON object."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class PrepareReport(_RunReport):
    """What `exumi_converters.prepare` did.

    Attributes
    ----------
    settings : dict
        Size, grey, quality.
    """

    settings: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportReport:
    """What `exumi_converters.export` did.

    Attributes
    ----------
    source, destination : str
    exporter : str
        Name and version.
    layout : str
        What was written.
    total : int
        Episodes of the source: ``written + skipped + len(failed)``, unless nothing was finished.
    written : int
        Episodes in the result, when this run finished it.
    skipped : int
        Episodes of a result that was there already.
    failed : tuple of Failure
    losses : tuple of Loss
        What the result lacks.
    notices : tuple of str
    frames : int
        Frames written by this run.
    bytes : int
        Size of the result.
    seconds : float
    """

    source: str
    destination: str
    exporter: str
    layout: str
    total: int
    losses: "tuple[Loss, ...]"
    written: int = 0
    skipped: int = 0
    failed: tuple[Failure, ...] = ()
    notices: tuple[str, ...] = ()
    frames: int = 0
    bytes: int = 0
    seconds: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether nothing failed."""
        return not self.failed

    def to_json(self) -> dict[str, Any]:
        """Return the report as a JSON object."""
        return asdict(self)
