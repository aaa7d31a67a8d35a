"""What is taken from an episode for the page: small numbers, which processes can send."""

from dataclasses import dataclass

from exumi_data.stats.html.blocks import STEPS
from exumi_data.stats.html.sound_figures import SoundFigures
from exumi_data.stats.html.taxel_figures import TaxelFigures

__all__ = [
    "STEPS",
    "ClockFigures",
    "EpisodeFigures",
    "PoseFigures",
    "TouchFigures",
    "ValueFigures",
]


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
    low, high : tuple of float
        Smallest and largest x, y and z, metres. Empty without a valid sample.
    tilts : dict of int to int
        Samples by angle between both z axes, in steps of 5 degrees.
    tilt_ends : tuple of float
        Smallest and largest of these angles, degrees. Empty without a valid sample.
    left_out : int
        Samples that are flagged as not valid, or are no numbers.
    """

    stream: str
    parent: str
    child: str
    from_above: dict[tuple[int, int], int]
    from_side: dict[tuple[int, int], int]
    low: tuple[float, ...]
    high: tuple[float, ...]
    tilts: dict[int, int]
    tilt_ends: tuple[float, ...]
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
    taxels: tuple[TaxelFigures, ...]
    large_taxels: tuple[tuple[str, tuple[int, int]], ...]
    """Streams of taxels that are not read, and their grids: too large to be drawn."""
    sounds: tuple[SoundFigures, ...]
    numbers: tuple[tuple[str, float], ...]
