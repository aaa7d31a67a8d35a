"""Encode the clips of a dataset, in several processes if wanted."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from exumi_data.engine import Engine, map_items
from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_loaders.clips import Clip, Clips
from exumi_loaders.encoder import Encoder
from exumi_loaders.options import one_of
from exumi_loaders.retrieval.entries import Entry
from exumi_loaders.retrieval.identities import frames_identity, identities

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = [
    "DamagedClip",
    "Embedding",
    "EncodedClips",
    "OnCorruptClip",
    "embed",
    "encode_clips",
    "entry_of_clip",
]

OnCorruptClip = Literal["raise", "skip"]

_EPISODES = 16  # of one piece of work


@dataclass(frozen=True)
class Embedding:
    """A vector of an encoder, and what it was made of.

    Attributes
    ----------
    vector : (D,) float32
        As the encoder gave it.
    encoder : str
        Digest of the encoder.
    origins : tuple of str
        What the clip can be told by, where that is known.
    """

    vector: np.ndarray
    encoder: str
    origins: tuple[str, ...] = ()


@dataclass(frozen=True)
class DamagedClip:
    """A clip that was left out.

    Attributes
    ----------
    episode : str
        Its id.
    stream : str
    frame : int or None
        The first damaged one of those that are encoded; None where it is not a frame that is
        damaged.
    where : str
        Path, stream and frame, as far as known.
    reason : str
    """

    episode: str
    stream: str
    frame: int | None
    where: str
    reason: str

    def __str__(self) -> str:
        return f"{self.where}: {self.reason}"


@dataclass(frozen=True, repr=False)
class EncodedClips:
    """Clips with their vectors.

    Attributes
    ----------
    vectors : (N, D) float32
    entries : list of Entry
    encoder : str
        Digest of the encoder.
    damaged : list of DamagedClip
        What was left out.
    """

    vectors: np.ndarray
    entries: list[Entry]
    encoder: str
    damaged: list[DamagedClip] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.entries)

    def __repr__(self) -> str:
        return f"<EncodedClips: {len(self)} of {self.encoder}, {len(self.damaged)} damaged>"

    def embedding(self, index: int) -> Embedding:
        """Return one clip as a query.

        Parameters
        ----------
        index : int
        """
        return Embedding(self.vectors[index], self.encoder, self.entries[index].origins)


@dataclass(frozen=True)
class _Reading:
    stream: str | tuple[str, ...] | None
    frames: int
    provenance: str


_Encoded = tuple[np.ndarray, Entry] | DamagedClip


def embed(
    encoder: Encoder,
    frames: np.ndarray,
    reference: np.ndarray | None,
    *,
    kind: tuple[str | None, str | None] = (None, None),
    origins: tuple[str, ...] = (),
) -> Embedding:
    """Encode one clip.

    Parameters
    ----------
    encoder : Encoder
    frames : (N, H, W, C) uint8
    reference : (H, W, C) uint8 or None
    kind : (str or None, str or None)
        Sensor model and pad type.
    origins : tuple of str
        What else the clip can be told by; its pixels always are.

    Raises
    ------
    UsageError
        The arrays have another shape or type, or the encoder gives something else than a vector.
    """
    if frames.ndim != 4 or frames.dtype != np.uint8:
        raise UsageError(f"frames are {frames.shape} {frames.dtype}, expected (N, H, W, C) uint8")
    vector = np.asarray(encoder.encode(frames, reference, kind=kind), dtype=np.float32)
    if vector.shape != (encoder.dimension,) or not np.isfinite(vector).all():
        raise UsageError(
            f"{encoder.name} gave {vector.shape}, expected ({encoder.dimension},) finite numbers"
        )
    return Embedding(vector, encoder.digest, (*origins, frames_identity(frames, reference)))


def encode_clips(  # noqa: PLR0913  # keyword-only options, each with a default
    dataset: "Dataset",
    encoder: Encoder,
    *,
    stream: str | Sequence[str] | None = None,
    frames: int = 10,
    provenance: str = "human",
    workers: int | None = 1,
    engine: Engine | None = None,
    on_corrupt: OnCorruptClip = "raise",
    on_done: Callable[[int, int], None] = lambda _done, _total: None,
) -> EncodedClips:
    """Encode all clips of a dataset.

    Parameters
    ----------
    dataset : exumi_data.Dataset
    encoder : Encoder
    stream : str or sequence of str, optional
    frames : int
    provenance : {"human", "any"}
        As of `Clips`.
    workers : int, optional
        Processes; None takes all cores. With more than one, the encoder is sent to them.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
        The encoder is sent to them.
    on_corrupt : {"raise", "skip"}
        Stop at a clip that cannot be decoded, or leave it out and name it in ``damaged``.
    on_done : callable
        Told of the clips that were read, and of all.

    Returns
    -------
    EncodedClips
        In the order of ``Clips(dataset).table``.

    Raises
    ------
    UsageError
        No clip; or the encoder does not fit the frames.
    DamagedDataError
        A frame cannot be decoded (names episode, stream and frame); or no clip can.
    ChangedDataError
        An episode is not what it was, whatever `on_corrupt` is.
    """
    one_of("on_corrupt", on_corrupt, ("raise", "skip"))
    reading = _Reading(stream if stream is None else _names(stream), frames, provenance)
    table = _clips(dataset, reading).table
    episodes = list(dict.fromkeys(clip.episode for clip in table))
    ids = [dataset.ids[episode] for episode in episodes]
    starts = range(0, len(ids), _EPISODES)
    # A few rows of the catalog are sent to a worker, not the dataset.
    pieces = {start: dataset.select(ids[start : start + _EPISODES]) for start in starts}
    work = partial(_encode, encoder=encoder, reading=reading, on_corrupt=on_corrupt)
    found: dict[int, list[_Encoded]] = {}
    done = 0
    for outcome in map_items(work, list(pieces.items()), workers=workers, engine=engine):
        if outcome.value is None:
            assert outcome.error is not None  # noqa: S101  # an outcome has one of the two
            raise outcome.error
        found[outcome.item[0]] = outcome.value
        done += len(outcome.value)
        on_done(done, len(table))
    results = [result for start in starts for result in found[start]]
    pairs = [result for result in results if not isinstance(result, DamagedClip)]
    damaged = [result for result in results if isinstance(result, DamagedClip)]
    if not pairs:
        raise DamagedDataError(
            f"all {len(damaged)} clips are damaged; the first: {damaged[0].reason}",
            where=damaged[0].where,
            fix=f"See all that is wrong with: exumi validate {dataset.path}",
        )
    vectors = np.stack([vector for vector, _ in pairs])
    return EncodedClips(vectors, [entry for _, entry in pairs], encoder.digest, damaged)


def _names(stream: str | Sequence[str]) -> str | tuple[str, ...]:
    return stream if isinstance(stream, str) else tuple(stream)


def _clips(dataset: "Dataset", reading: _Reading) -> Clips:
    return Clips(
        dataset,
        stream=reading.stream,
        frames=reading.frames,
        provenance="any" if reading.provenance == "any" else "human",
    )


def _encode(
    item: tuple[int, "Dataset"],
    *,
    encoder: Encoder,
    reading: _Reading,
    on_corrupt: OnCorruptClip,
) -> list[_Encoded]:
    clips = _clips(item[1], reading)
    return list(_encoded(clips, encoder, on_corrupt))


def _encoded(clips: Clips, encoder: Encoder, on_corrupt: OnCorruptClip) -> Iterator[_Encoded]:
    for index, clip in enumerate(clips.table):
        try:
            frames, reference = _read(clips, index)
        except DamagedDataError as error:
            if on_corrupt == "raise" or isinstance(error, ChangedDataError):
                raise
            yield _damaged(clips, index, error)
            continue
        with clips.dataset[clip.episode] as episode:
            origins = identities(episode.metadata, clip.stream)
        try:
            made = embed(encoder, frames, reference, kind=clip.kind, origins=origins)
        except UsageError as error:
            where = f"{clips.dataset.episode_location(clip.episode)}, stream {clip.stream}"
            raise UsageError(error.what, where=error.where or where, fix=error.fix) from None
        yield made.vector, entry_of_clip(clip, made.origins)


def _read(clips: Clips, index: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Decode the salient frames that a clip has, none of them twice."""
    which = np.flatnonzero(clips.salient(index).valid)
    frames = np.empty((1, len(which), *clips.table[index].shape), dtype=np.uint8)
    clips.read_batch(np.array([index]), which[None], frames)  # names the frame that is damaged
    return frames[0], clips.read_into(index, frames[0, :0], which=which[:0])


def _damaged(clips: Clips, index: int, error: DamagedDataError) -> DamagedClip:
    clip = clips.table[index]
    path = f"{clips.dataset.episode_location(clip.episode)}, stream {clip.stream}"
    # The error names a frame only where it is a frame that is damaged.
    _, _, number = (error.where or "").partition(f"{path}, frame ")
    frame = int(number) if number.isdecimal() else None
    return DamagedClip(clip.id, clip.stream, frame, error.where or path, error.what)


def entry_of_clip(clip: Clip, origins: tuple[str, ...]) -> Entry:
    """Describe a clip for an index.

    Parameters
    ----------
    clip : Clip
    origins : tuple of str
        What it can be told by.

    Returns
    -------
    Entry
    """
    name = clip.object or clip.object_id or clip.part or clip.part_id or f"clip {clip.id[:8]}"
    by_model = "model" in clip.provenance.values()
    return Entry(
        id=f"{clip.id}/{clip.stream}",
        name=name,
        object_id=clip.object_id,
        part_id=clip.part_id,
        part=clip.part,
        sensor_model=clip.sensor_model,
        pad_type=clip.pad_type,
        adjectives=clip.adjectives,
        labels=dict(clip.labels),
        provenance="model" if by_model else "human",
        origins=origins,
    )
