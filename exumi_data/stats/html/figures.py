"""What is taken from an episode for the page: small numbers, which processes can send."""

from dataclasses import dataclass

__all__ = [
    "STEPS",
    "ClockFigures",
    "EpisodeFigures",
    "PoseFigures",
    "TouchFigures",
    "ValueFigures",
]

STEPS = 40
"""Equal parts of an episode in which activity over time is counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockFigures:
    """How one stream's times came about: all in ns, sigmas None where nothing is stated."""

    stream: str
    source: str
    stamp_point: str
    latency_ns: int
    latency_sigma_ns: float | None
    offset_sigma_ns: float | None
    drift_ppm: float
    method: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchFigures:
    """The stored activity of one tactile stream.

    Attributes
    ----------
    stream : str
    measured : bool
        Whether activity is stored.
    has_reference : bool
    frames, active : tuple of int
        Frames, and active ones, in each of `STEPS` parts of the episode.
    peak : float
        Largest activity.
    """

    stream: str
    measured: bool
    has_reference: bool
    frames: tuple[int, ...]
    active: tuple[int, ...]
    peak: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueFigures:
    """A stream of numbers, counted in steps of `step`; key: the stream, and the component."""

    stream: str
    component: str
    kind: str
    unit: str
    step: float
    counts: dict[int, int]
    left_out: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFigures:
    """Where a pose stream was: visits of cells seen from above and from the side, tilts.

    Attributes
    ----------
    stream, parent, child : str
    from_above, from_side : dict of (int, int) to int
        Samples by cell of 1 cm: x and y, x and z.
    tilts : dict of int to int
        Samples by angle between both z axes, in steps of 5 degrees.
    left_out : int
        Samples that are flagged as not valid, or are no numbers.
    """

    stream: str
    parent: str
    child: str
    from_above: dict[tuple[int, int], int]
    from_side: dict[tuple[int, int], int]
    tilts: dict[int, int]
    left_out: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeFigures:
    """One episode; see the fields' own classes."""

    id: str
    duration_s: float
    regime: str
    task: str
    instruction: str | None
    object_id: str | None
    part_id: str | None
    operator: str | None
    site: str | None
    device: str | None
    embodiment: str | None
    sensors: dict[str, str]
    kinds: dict[str, str]
    touches: tuple[TouchFigures, ...]
    clocks: tuple[ClockFigures, ...]
    values: tuple[ValueFigures, ...]
    poses: tuple[PoseFigures, ...]
    numbers: tuple[tuple[str, float], ...]
