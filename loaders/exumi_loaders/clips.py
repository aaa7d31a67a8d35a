"""Touch clips: one entry a tactile stream of an episode, with labels and salient frames."""

import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from exumi_data.engine import map_items
from exumi_data.episode import Episode, StreamView, open_episode
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.model.description import Annotations, Label
from exumi_data.model.streams import TactileStream
from exumi_loaders.readers import FrameReaders
from exumi_loaders.window_frames import read_frames

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["Clip", "Clips", "SalienceWarning", "SalientFrames"]

Provenance = Literal["human", "any"]

RATING_SCALE = (0.0, 10.0)
"""Lowest and highest rating, whatever scale a label was given on (Octopi's)."""

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
        if frames < 1:
            raise UsageError(f"frames is {frames}, not a positive number")
        if provenance not in ("human", "any"):
            raise UsageError(
                f"invalid provenance ({provenance!r}). Supported values are 'human', 'any'"
            )
        wanted = None if stream is None else {stream} if isinstance(stream, str) else set(stream)
        self.dataset = dataset
        self.frames = frames
        self.table, self.left_out, encodings, roots = _list_clips(dataset, wanted, provenance)
        if not self.table:
            reasons = "; ".join(f"{count} {reason}" for reason, count in self.left_out.items())
            raise UsageError(
                f"no touch clip in {len(dataset)} episode(s){': ' * bool(reasons)}{reasons}",
                where=dataset.path,
                fix=None if wanted is None else "Name a tactile stream that the episodes have.",
            )
        self._readers = FrameReaders(dataset, encodings, roots)
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
        ChangedDataError
            The episode is not the one that was there when the dataset was opened.
        """
        clip = self.table[index]
        out = np.empty((self.frames, *clip.shape), dtype=np.uint8)
        reference = np.empty(clip.shape, dtype=np.uint8) if clip.has_reference else None
        self.read_into(index, out, reference)
        return out, reference

    def read_into(
        self,
        index: int,
        out: np.ndarray,
        reference: np.ndarray | None = None,
        *,
        which: np.ndarray | None = None,
        on_corrupt: Literal["raise", "substitute"] = "raise",
    ) -> np.ndarray:
        """Decode the salient frames of a clip into a buffer.

        Parameters
        ----------
        index : int
            Position in `table`.
        out : (k, H, W, C) uint8, C-contiguous
            C = 1 asks for luma.
        reference : (H, W, C) uint8, optional
            Where the image without contact goes, if there is one.
        which : (k,) int, optional
            Which of the K salient frames; default all.
        on_corrupt : {"raise", "substitute"}
            ``substitute`` leaves damaged frames black.

        Returns
        -------
        (k,) bool
            Which of them are damaged.

        Raises
        ------
        DamagedDataError, ChangedDataError
            As of `read`.
        """
        clip = self.table[index]
        numbers = self.salient(index).numbers
        outcome = read_frames(
            self._readers,
            clip.stream,
            np.array([clip.episode]),
            (numbers if which is None else numbers[which])[None],
            np.array([0]),
            out[None],
            None if reference is None else reference[None],
            on_corrupt=on_corrupt,
        )
        return np.asarray(outcome.damaged[0])

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
) -> tuple[list[Clip], dict[str, int], dict[str, str], np.ndarray]:
    """Return clips, what was left out, how frames are stored, and roots (E, 32) uint8."""
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
    read = partial(_describe, provenance=provenance)
    few = len(chosen) < _MANY_EPISODES
    for outcome in map_items(read, list(locations), workers=1 if few else None):
        if outcome.value is None:
            assert outcome.error is not None  # noqa: S101  # an outcome has one of the two
            raise outcome.error
        position = locations[outcome.item]
        root, described[position] = outcome.value
        roots[position] = np.frombuffer(bytes.fromhex(root), dtype=np.uint8)
    table = [
        replace(clip, episode=position)
        for position in chosen
        for name, clip in described[position].items()
        if name in frames[position]
    ]
    reasons = {reason: count for reason, count in left_out.items() if count}
    return table, reasons, encodings, roots


def _describe(location: str, *, provenance: Provenance) -> tuple[str, dict[str, Clip]]:
    """Read an episode's SHA-256 of its root document, and what is known of its clips."""
    episode = open_episode(location)
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
    return episode.root_sha256, found


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
