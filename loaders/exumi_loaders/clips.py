"""Touch clips: one entry a tactile stream of an episode, with labels and salient frames."""

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from exumi_data.engine import map_items
from exumi_data.episode import Episode, StreamView, open_episode
from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_data.model.description import Annotations, Label
from exumi_data.model.streams import TactileStream
from exumi_data.store.access import open_stores
from exumi_loaders.readers import FrameReaders
from exumi_loaders.reading_ahead import parts_at_hand
from exumi_loaders.window_frames import OnCorrupt, Outcome, read_frames

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset
    from exumi_data.store.remote.reading import Identity

__all__ = ["Clip", "Clips", "SalienceWarning", "SalientFrames"]

Provenance = Literal["human", "any"]

RATING_SCALE = (0.0, 10.0)
"""Lowest and highest rating, whatever scale a label was given on (Octopi's)."""

MOST_FRAMES = 4096
"""Salient frames of a clip at most: a batch has room for so many, whatever its clips have."""

_MANY_EPISODES = 2000


class SalienceWarning(UserWarning):
    """Salient frames are not stored and were computed, for which whole clips are decoded."""


@dataclass(frozen=True)
class Clip:
    """One tactile stream of one episode.

    Attributes
    ----------
    episode : int
        Position in ``Clips.dataset``.
    id : str
        The episode's id.
    stream : str
        Name of the tactile stream.
    shape : (int, int, int)
        Height, width and channels of its frames.
    has_reference : bool
        Whether an image without contact is stored.
    sensor_model, pad_type : str or None
        What touched; None where it is not known.
    object_id, part_id : str or None
    object, part : str or None
        Both in words: "a hairbrush", "handle".
    trial : int or None
    procedure : str or None
        Exploratory procedure, such as ``press``.
    labels : dict of str to float
        Ratings by property, from 0 to 10; a property without a label is not there. Several labels
        of one property and provenance are averaged.
    adjectives : tuple of str
    provenance : dict of str to str
        ``human`` or ``model`` for each property of `labels`, and for ``adjectives``.
    """

    episode: int
    id: str
    stream: str
    shape: tuple[int, int, int]
    has_reference: bool = False
    sensor_model: str | None = None
    pad_type: str | None = None
    object_id: str | None = None
    part_id: str | None = None
    object: str | None = None
    part: str | None = None
    trial: int | None = None
    procedure: str | None = None
    labels: dict[str, float] = field(default_factory=dict)
    adjectives: tuple[str, ...] = ()
    provenance: dict[str, Literal["human", "model"]] = field(default_factory=dict)

    @property
    def kind(self) -> tuple[str | None, str | None]:
        """Sensor model and pad type: only clips of one kind can be told apart by touch alone."""
        return (self.sensor_model, self.pad_type)


class SalientFrames(NamedTuple):
    """Which frames of a clip are handed out.

    Attributes
    ----------
    numbers : (K,) int64
        Frames of the stream in time order; a clip that has fewer repeats its last.
    valid : (K,) bool
        False for repetitions.
    stored : bool
        Whether the selection was stored with the episode, or had to be computed.
    """

    numbers: np.ndarray
    valid: np.ndarray
    stored: bool


class Clips:
    """The touch clips of a dataset. Needs no PyTorch.

    Opening reads the metadata of every episode, and no frame. Episodes without a tactile stream,
    and streams without a frame, are left out and counted.

    Parameters
    ----------
    dataset : exumi_data.Dataset
    stream : str or sequence of str, optional
        Tactile streams; default all.
    frames : int
        K, how many salient frames a clip gives; 10 in Octopi.
    provenance : {"human", "any"}
        Whose labels count. With ``any``, a model's label is taken where there is no person's.

    Attributes
    ----------
    dataset : exumi_data.Dataset
    frames : int
    table : list of Clip
    left_out : dict of str to int
        How many episodes or streams were left out, by reason.

    Raises
    ------
    UsageError
        No clip is left.

    Examples
    --------
    >>> clips = Clips(exumi_data.open("my-dataset"))  # doctest: +SKIP
    >>> frames, reference = clips.read(0)  # doctest: +SKIP
    >>> frames.shape  # doctest: +SKIP
    (10, 240, 320, 3)
    """

    def __init__(
        self,
        dataset: "Dataset",
        *,
        stream: str | Sequence[str] | None = None,
        frames: int = 10,
        provenance: Provenance = "human",
    ) -> None:
        if not 1 <= frames <= MOST_FRAMES:
            raise UsageError(f"frames is {frames}, not from 1 to {MOST_FRAMES}")
        if provenance not in ("human", "any"):
            raise UsageError(
                f"invalid provenance ({provenance!r}). Supported values are 'human', 'any'"
            )
        wanted = None if stream is None else {stream} if isinstance(stream, str) else set(stream)
        self.dataset = dataset
        self.frames = frames
        self.table, self.left_out, encodings, roots, identities = _list_clips(
            dataset, wanted, provenance
        )
        if not self.table:
            reasons = "; ".join(f"{count} {reason}" for reason, count in self.left_out.items())
            raise UsageError(
                f"no touch clip in {len(dataset)} episode(s){': ' * bool(reasons)}{reasons}",
                where=dataset.path,
                fix=None if wanted is None else "Name a tactile stream that the episodes have.",
            )
        self._readers = FrameReaders(dataset, encodings, roots, identities)
        self._salient: dict[int, SalientFrames] = {}

    def __len__(self) -> int:
        return len(self.table)

    def __repr__(self) -> str:
        parts = len({clip.part_id for clip in self.table} - {None})
        return f"<Clips: {len(self)} of {len(self.dataset)} episodes, {parts} parts>"

    def salient(self, index: int) -> SalientFrames:
        """Return which frames of a clip are handed out.

        Parameters
        ----------
        index : int
            Position in `table`.

        Returns
        -------
        SalientFrames
        """
        found = self._salient.get(index)
        if found is None:
            found = self._select(self.table[index])
            self._salient[index] = found
        return found

    def read(self, index: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Decode the salient frames of a clip.

        Parameters
        ----------
        index : int
            Position in `table`.

        Returns
        -------
        frames : (K, H, W, C) uint8
            In time order, grey or colour as stored. ``salient(index).valid`` says which are not
            repetitions.
        reference : (H, W, C) uint8 or None
            The image without contact.

        Raises
        ------
        DamagedDataError
            A frame cannot be decoded; names episode, stream and frame.
        """
        out = np.empty((self.frames, *self.table[index].shape), dtype=np.uint8)
        return out, self.read_into(index, out)

    def read_into(
        self, index: int, out: np.ndarray, *, which: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Decode the salient frames of a clip into a buffer.

        Parameters
        ----------
        index : int
            Position in `table`.
        out : (k, H, W, C) uint8, C-contiguous
            C = 1 asks for luma.
        which : (k,) int, optional
            Which of the K salient frames; default all.

        Returns
        -------
        (H, W, C) uint8 or None
            The reference, with the channels that are stored.
        """
        clip = self.table[index]
        numbers = self.salient(index).numbers
        source, reference = self._readers.get(clip.episode, clip.stream)
        source.read_into(numbers if which is None else numbers[which], out)
        return reference

    def read_batch(
        self,
        chosen: np.ndarray,
        which: np.ndarray,
        out: np.ndarray,
        reference: np.ndarray | None = None,
        *,
        on_corrupt: OnCorrupt = "raise",
    ) -> Outcome:
        """Decode salient frames of several clips into a buffer.

        Parameters
        ----------
        chosen : (B,) int
            Positions in `table`; frames of one size.
        which : (B, k) int
            Which of the K salient frames of each.
        out : (B, k, H, W, C) uint8, C-contiguous
            C = 1 asks for luma.
        reference : (B, H, W, C) uint8, optional
            Where the images without contact go.
        on_corrupt : {"raise", "skip", "substitute"}
            ``raise`` stops at the first damaged frame; the others make it black and say so. Where
            the reference or the selection is damaged, all frames of the clip count as damaged.

        Returns
        -------
        Outcome

        Raises
        ------
        DamagedDataError
            Names episode, stream and frame.
        ChangedDataError
            The dataset is not what it was when it was opened; whatever `on_corrupt` is.
        """
        there = np.zeros(which.shape, dtype=bool)
        damaged = np.zeros(which.shape, dtype=bool)
        episodes = np.array([self.table[index].episode for index in chosen.tolist()], np.int64)
        streams = [self.table[index].stream for index in chosen.tolist()]
        self._readers.open_together(episodes, dict.fromkeys(streams))
        numbers = np.full(which.shape, -1, dtype=np.int64)
        for row, index in enumerate(chosen.tolist()):
            try:
                numbers[row] = self.salient(index).numbers[which[row]]
            except DamagedDataError as error:
                if on_corrupt == "raise" or isinstance(error, ChangedDataError):
                    raise
                out[row] = 0
                if reference is not None:
                    reference[row] = 0
                damaged[row] = True
        wanted = {
            name: np.where(np.array([[name == stream] for stream in streams]), numbers, -1)
            for name in dict.fromkeys(streams)
        }
        for part in parts_at_hand(self._readers, episodes, wanted):
            for row in np.arange(len(chosen))[part].tolist():
                if damaged[row].all():
                    continue
                rows = slice(row, row + 1)
                there[rows], damaged[rows] = read_frames(
                    self._readers,
                    streams[row],
                    episodes[rows],
                    numbers[rows],
                    np.array([row]),
                    out,
                    reference,
                    on_corrupt=on_corrupt,
                )
        return Outcome(there, damaged)

    def _select(self, clip: Clip) -> SalientFrames:
        episode = self._readers.episode(clip.episode)
        view = episode[clip.stream]
        count = len(view)
        numbers = _stored_salient(episode, view, self.frames)
        stored = numbers is not None
        if numbers is None:
            warnings.warn(
                f"{self.dataset.path}: {self.frames} salient frames are not stored with every clip "
                "and are computed, which decodes the whole clip once",
                SalienceWarning,
                stacklevel=4,
            )
            numbers = _computed_salient(view, self.frames)
        if not len(numbers) or numbers[0] < 0 or numbers[-1] >= count:
            raise DamagedDataError(
                f"salient frames {numbers.tolist()} of {count} frames",
                where=f"{episode.path}/derived/{clip.stream}/salient",
                fix=f"See all that is wrong with: exumi validate {episode.path}",
            )
        valid = np.arange(self.frames) < len(numbers)
        padded = np.pad(numbers, (0, self.frames - len(numbers)), mode="edge")
        return SalientFrames(padded, valid, stored)


def _stored_salient(episode: Episode, view: StreamView, wanted: int) -> np.ndarray | None:
    """Return the stored selection if it is one of as many frames as are wanted."""
    from exumi_data.tactile.salience import SALIENCE_METHOD

    key = f"{view.name}/salient"
    item = episode.derived.items.get(key) if episode.derived else None
    if item is None or item.algorithm != SALIENCE_METHOD:
        return None
    numbers = view.salient
    if numbers is None or numbers.ndim != 1 or numbers.dtype.kind not in "iu":
        return None
    # A clip that is shorter than the selection has all of its frames in it.
    same = item.parameters.get("k", len(numbers)) == wanted or len(numbers) == len(view)
    return numbers.astype(np.int64) if same and len(numbers) == min(wanted, len(view)) else None


def _computed_salient(view: StreamView, wanted: int) -> np.ndarray:
    from exumi_data.tactile.salience import difference_energy, salient_frames  # OpenCV

    energy = []
    before: np.ndarray | None = None
    for frame in view.frames.iterate(grey=True):
        grey = frame[..., 0]
        energy.append(difference_energy(grey if before is None else before, grey))
        before = grey
    return salient_frames(np.asarray(energy, dtype=np.int64), wanted)


def _list_clips(
    dataset: "Dataset", wanted: set[str] | None, provenance: Provenance
) -> "tuple[list[Clip], dict[str, int], dict[str, str], np.ndarray, dict[str, Identity]]":
    """Return clips, what was left out, how frames are stored, and which episodes they are of."""
    left_out: Counter[str] = Counter()
    chosen: list[int] = []
    encodings: dict[str, str] = {}
    frames: dict[int, dict[str, int]] = {}
    for position, streams in enumerate(dataset.catalog.column("streams").to_pylist()):
        tactile = {s["name"]: s for s in streams if s["kind"] == "tactile"}
        named = {name: s for name, s in tactile.items() if wanted is None or name in wanted}
        if not named:
            left_out["without such a tactile stream"] += 1
            continue
        left_out["without a frame"] += sum(not s["n"] for s in named.values())
        frames[position] = {name: s["n"] for name, s in named.items() if s["n"]}
        chosen.append(position)
        for name, s in named.items():
            # Readers of video hold a whole file each: where streams differ, few are kept.
            if encodings.get(name) != "video":
                encodings[name] = s["encoding"]
    locations = {dataset.episode_location(position): position for position in chosen}
    described: dict[int, dict[str, Clip]] = {}
    roots = np.zeros((len(dataset), 32), dtype=np.uint8)
    identities: dict[str, Identity] = {}
    for location, (described_here, root, identity) in _described(list(locations), provenance):
        position = locations[location]
        described[position] = described_here
        roots[position] = np.frombuffer(bytes.fromhex(root), dtype=np.uint8)
        if identity is not None:
            identities[location] = identity
    table = [
        replace(clip, episode=position)
        for position in chosen
        for name, clip in described[position].items()
        if name in frames[position]
    ]
    reasons = {reason: count for reason, count in left_out.items() if count}
    return table, reasons, encodings, roots, identities


def _described(
    locations: list[str], provenance: Provenance
) -> "Iterator[tuple[str, _Description]]":
    """Describe episodes; many of them in several processes."""
    if len(locations) < _MANY_EPISODES:
        for location, store in zip(locations, open_stores(locations), strict=True):
            yield location, _describe(Episode(store), provenance)
        return
    read = partial(_describe_at, provenance=provenance)
    for outcome in map_items(read, locations):
        if outcome.value is None:
            assert outcome.error is not None  # noqa: S101  # an outcome has one of the two
            raise outcome.error
        yield outcome.item, outcome.value


def _describe_at(location: str, *, provenance: Provenance) -> "_Description":
    return _describe(open_episode(location), provenance)


class _Description(NamedTuple):
    """What is known of an episode's tactile streams, and which revision and object it is."""

    clips: dict[str, Clip]
    root_sha256: str
    identity: "Identity | None"


def _describe(episode: Episode, provenance: Provenance) -> _Description:
    """Read what is known of the tactile streams of an episode."""
    about = episode.metadata.annotations or Annotations()
    labels, origin = _ratings(about.labels or (), provenance)
    adjectives = _adjectives(about.labels or (), provenance, origin)
    found = {}
    for view in episode.of_kind("tactile"):
        stream = view.metadata
        assert isinstance(stream, TactileStream)  # noqa: S101  # by its kind
        found[view.name] = Clip(
            episode=-1,
            id=episode.id,
            stream=view.name,
            shape=(stream.images.height, stream.images.width, stream.images.channels),
            has_reference="reference" in stream.arrays,
            sensor_model=stream.sensor.model if stream.sensor else None,
            pad_type=about.pad_type,
            object_id=about.object_id,
            part_id=about.part_id,
            object=about.object,
            part=about.part,
            trial=about.trial,
            procedure=about.procedure,
            labels=labels,
            adjectives=adjectives,
            provenance=origin,
        )
    return _Description(found, episode.root_sha256, episode.store.identity)


def _ratings(
    labels: Iterable[Label], provenance: Provenance
) -> tuple[dict[str, float], dict[str, Literal["human", "model"]]]:
    """Return ratings from 0 to 10 by property, and whose they are.

    Numbers without a scale, or outside of it, are no ratings: nothing says what they mean.
    """
    values: dict[tuple[str, str], list[float]] = {}
    for label in labels:
        rating = _rating(label)
        if rating is not None:
            values.setdefault((label.property, label.provenance), []).append(rating)
    ratings: dict[str, float] = {}
    origin: dict[str, Literal["human", "model"]] = {}
    for (name, whose), numbers in values.items():
        person = whose == "human"
        if person or (provenance == "any" and (name, "human") not in values):
            ratings[name] = sum(numbers) / len(numbers)
            origin[name] = "human" if person else "model"
    return ratings, origin


def _rating(label: Label) -> float | None:
    """Return a label as a rating, or None where it is no number on a scale."""
    if not isinstance(label.value, float) or label.scale is None:
        return None
    low, high = label.scale
    if not low <= label.value <= high or low == high:
        return None
    if (low, high) == RATING_SCALE:
        return label.value  # exactly as it was given
    return RATING_SCALE[1] * (label.value - low) / (high - low)


def _adjectives(
    labels: Iterable[Label],
    provenance: Provenance,
    origin: dict[str, Literal["human", "model"]],
) -> tuple[str, ...]:
    """Return adjectives, each once, and note whose they are."""
    words: dict[str, list[str]] = {"human": [], "model": []}
    for label in labels:
        if label.property == "adjectives" and isinstance(label.value, list | str):
            several = label.value if isinstance(label.value, list) else [label.value]
            words[label.provenance] += several
    whose: tuple[Literal["human", "model"], ...] = (
        ("human", "model") if provenance == "any" else ("human",)
    )
    for one in whose:
        if words[one]:
            origin["adjectives"] = one
            return tuple(dict.fromkeys(words[one]))
    return ()
