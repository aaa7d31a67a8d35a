"""What the statistics hold. All are plain data: ``dataclasses.asdict`` makes the JSON document."""

from dataclasses import dataclass

__all__ = [
    "ActiveTactile",
    "Content",
    "Labels",
    "Range",
    "Regime",
    "Sizes",
    "Statistics",
    "StreamStatistics",
    "Unreadable",
    "Usable",
]


@dataclass(frozen=True, slots=True)
class Range:
    """Smallest, median and largest of one number an episode."""

    min: float
    median: float
    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamStatistics:
    """One stream, by name, over all episodes that have it.

    Attributes
    ----------
    name, kind : str
        Episodes with a stream of the same name and another kind are listed apart.
    encodings : list of str
        How its frames are stored; empty for streams without frames.
    episodes : int
        Episodes that have it.
    empty : int
        Of these, episodes in which it holds no sample.
    n : int
        Samples.
    duration_s : float
        First to last sample, summed over episodes.
    nominal_hz : dict of str to int
        Stated rate (a rational number, as it is stored), and how many episodes state it.
    measured_times : bool
        False when no time of the stream was measured (all clocks say ``nominal_rate``): rate and
        jitter then repeat what was stated.
    rate_hz : Range or None
        Inverse of the median period, by episode; gaps do not lower it. None where no episode
        has two samples.
    jitter_s : Range or None
        1.4826 × the median absolute deviation of the periods, by episode, seconds.
    gaps : int
        Periods longer than 2.5 median periods.
    longest_gap_s : float
        The longest of these, seconds; 0 without gaps.
    episodes_with_gaps : int
        Episodes in which there is a gap.
    declared_gaps : int
        Gaps that the metadata declares.
    lost : dict of str to int
        Samples that the recorder counted as lost, by cause.
    active_above : list of float
        Tactile: thresholds of activity in use.
    active : int or None
        Tactile: frames whose own activity is above the threshold; None without stored activity.
    measured_activity : int
        Frames that have stored activity.
    bytes : int
        Size on disk, without what was derived from it.
    bytes_per_sample : float or None
        `bytes` by `n`.
    usable : float or None
        Share of ticks at which this stream alone is valid (see `Usable`).
    """

    name: str
    kind: str
    encodings: list[str]
    episodes: int
    empty: int
    n: int
    duration_s: float
    nominal_hz: dict[str, int]
    measured_times: bool
    rate_hz: Range | None
    jitter_s: Range | None
    gaps: int
    longest_gap_s: float
    episodes_with_gaps: int
    declared_gaps: int
    lost: dict[str, int]
    active_above: list[float]
    active: int | None
    measured_activity: int
    bytes: int
    bytes_per_sample: float | None
    usable: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ActiveTactile:
    """How much of the tactile data is contact.

    A moment is active if any tactile stream is. The moments of an episode are the times of its
    densest tactile stream (the one with most frames; of equals the first by name); each other
    tactile stream counts with its nearest frame, if that lies within the loaders' tolerance: one
    tick, or 0.6 median periods if that is longer.

    Attributes
    ----------
    episodes : int
        Episodes with tactile streams whose activity is stored for every one of them.
    unmeasured : int
        Episodes with tactile streams, of which at least one lacks stored activity: not counted.
    frames, active : int
        Moments, and active ones.
    ratio : float or None
        ``active / frames``.
    """

    episodes: int
    unmeasured: int
    frames: int
    active: int
    ratio: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Usable:
    """How much of the recorded time all required streams cover.

    Ticks lie `tick_s` apart, from the first sample of any required stream to the last: a stream
    that starts late or dies early makes ticks unusable. A stream of frames is valid at a tick if
    a frame lies within one tick, or 0.6 median periods if that is longer; any other stream if the
    tick lies between two samples at most 0.1 s apart, or 2.5 median periods if that is longer.

    Attributes
    ----------
    tick_s : float
        Distance of two ticks, seconds.
    required : list of str or None
        The required streams; None means all streams that an episode has.
    ticks, usable : int
        Ticks, and those at which every required stream is valid.
    ratio : float or None
        ``usable / ticks``.
    without : int
        Episodes that lack a required stream: none of their ticks is usable.
    """

    tick_s: float
    required: list[str] | None
    ticks: int
    usable: int
    ratio: float | None
    without: int


@dataclass(frozen=True, slots=True)
class Regime:
    """The episodes of one regime.

    Attributes
    ----------
    episodes : int
    duration_s : float
        Recorded time: first to last sample of any stream, summed.
    per_hour : float or None
        Episodes per hour of recorded time.
    """

    episodes: int
    duration_s: float
    per_hour: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """The values of one labelled property.

    Attributes
    ----------
    property : str
    episodes, missing : int
        Episodes with such a label (that has a value), and without.
    numbers : Range or None
        Values that are numbers.
    scales : list of [low, high]
        Scales that are stated.
    words : dict of str to int
        Values that are words, each with its number of episodes, most frequent first.
    provenance : dict of str to int
        ``human`` and ``model``.
    """

    property: str
    episodes: int
    missing: int
    numbers: Range | None
    scales: list[list[float]]
    words: dict[str, int]
    provenance: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """What was touched, how, and what is known of it: value to number of episodes.

    Episodes that do not say are counted under ``""``.
    """

    tasks: dict[str, int]
    objects: dict[str, int]
    parts: dict[str, int]
    procedures: dict[str, int]
    pad_types: dict[str, int]
    success: dict[str, int]
    licences: dict[str, int]
    sources: dict[str, int]
    lossy_steps: dict[str, int]
    quality: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Bytes on disk.

    Attributes
    ----------
    bytes : int
        Everything.
    streams, derived, metadata : int
        Parts of it: arrays of streams; what was derived; documents and the rest.
    """

    bytes: int
    streams: int
    derived: int
    metadata: int


@dataclass(frozen=True, slots=True)
class Unreadable:
    """An episode that could not be read, and why: it is in none of the numbers."""

    path: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """Statistics of an episode or a dataset.

    Attributes
    ----------
    path : str
    what : str
        ``episode`` or ``dataset``.
    name : str
        The dataset's name, or the episode's id.
    episodes : int
        Episodes that were read.
    duration_s : float
        Recorded time: first to last sample of any stream, summed over episodes.
    episode_duration_s : Range or None
        The same by episode.
    demonstrations_per_hour : float or None
        Episodes of the regimes ``demonstration`` and ``play`` per hour of their recorded time.
        The time between episodes is not recorded, so this is an upper bound of what an operator
        collects in an hour. Clips of the regime ``touch`` are no demonstrations: see `regimes`.
    regimes : dict of str to Regime
    streams : list of StreamStatistics
    active : ActiveTactile
    usable : Usable
    content : Content
    labels : list of Labels
    sizes : Sizes
    unreadable : list of Unreadable
    """

    path: str
    what: str
    name: str
    episodes: int
    duration_s: float
    episode_duration_s: Range | None
    demonstrations_per_hour: float | None
    regimes: dict[str, Regime]
    streams: list[StreamStatistics]
    active: ActiveTactile
    usable: Usable
    content: Content
    labels: list[Labels]
    sizes: Sizes
    unreadable: list[Unreadable]
