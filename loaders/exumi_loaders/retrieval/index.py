"""`TactileIndex`: what has felt like this before."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from exumi_data.engine import Engine
from exumi_data.errors import UsageError
from exumi_loaders.encoder import Encoder, Kind
from exumi_loaders.retrieval import changes
from exumi_loaders.retrieval.building import (
    DamagedClip,
    Embedding,
    OnCorruptClip,
    embed,
    encode_clips,
)
from exumi_loaders.retrieval.contents import Backend, IndexInfo, open_contents
from exumi_loaders.retrieval.document import IndexDocument, SourceStatement
from exumi_loaders.retrieval.entries import Entry, Provenance
from exumi_loaders.retrieval.folder import changing
from exumi_loaders.retrieval.matches import (
    RANKINGS,
    UNIQUE,
    Match,
    Ranking,
    Unique,
    check_choice,
    look,
    rank,
    similar_line,
)
from exumi_loaders.retrieval.space import unit
from exumi_loaders.retrieval.teaching import taught_entry
from exumi_loaders.retrieval.writing import fill_index, new_index

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["Example", "TactileIndex"]

Example = Embedding | tuple[np.ndarray, np.ndarray | None]
"""A clip to query or teach with: its embedding, or (frames, reference)."""


class TactileIndex:
    """Clips by what they feel like. Make one with `build`, or open one with `open`.

    Needs no PyTorch; the encoder may.

    Parameters
    ----------
    path : path-like
    encoder : Encoder, optional
        Default the built-in one, if the index was made with it.
    backend : {"exact", "faiss"}

    Examples
    --------
    >>> index = TactileIndex.build(dataset, path="my-index")  # doctest: +SKIP
    >>> index.query(frames, reference)[0].name  # doctest: +SKIP
    'a sponge'
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        encoder: Encoder | None = None,
        backend: Backend = "exact",
    ) -> None:
        check_choice("backend", backend, ("exact", "faiss"))
        self.path = Path(path)
        self._backend = backend
        self._contents = open_contents(self.path, backend)
        self.encoder = encoder or _built_in(self.document.encoder.digest)
        if encoder is not None:
            self._check_encoder(encoder.digest)

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        *,
        encoder: Encoder | None = None,
        backend: Backend = "exact",
    ) -> "TactileIndex":
        """Open an index. Its vectors are mapped into memory, not read.

        Their checksums are compared when they are first searched; `verify_index` compares all.

        Parameters
        ----------
        path : path-like
        encoder : Encoder, optional
            Default the built-in one, if the index was made with it. Without one, only embeddings
            can be queried.
        backend : {"exact", "faiss"}
            Compare with every vector, or with FAISS approximately.

        Returns
        -------
        TactileIndex

        Raises
        ------
        NotAnEpisodeError
            No index is there.
        MetadataError, UnsupportedError, DamagedDataError, LimitError
            It cannot be read.
        UsageError
            The encoder is not the one that it was made with.
        MissingExtraError
            FAISS is asked for and not installed.
        """
        return cls(path, encoder=encoder, backend=backend)

    @classmethod
    def build(  # noqa: PLR0913  # keyword-only options, each with a default
        cls,
        dataset: "Dataset",
        encoder: Encoder | None = None,
        *,
        path: str | os.PathLike[str],
        split: str | None = None,
        stream: str | Sequence[str] | None = None,
        frames: int = 10,
        provenance: Literal["human", "any"] = "human",
        workers: int | None = 1,
        engine: Engine | None = None,
        on_corrupt: OnCorruptClip = "raise",
        on_damaged: Callable[[DamagedClip], None] = lambda _clip: None,
        on_done: Callable[[int, int], None] = lambda _done, _total: None,
    ) -> "TactileIndex":
        """Build an index from the touch clips of a dataset.

        Parameters
        ----------
        dataset : exumi_data.Dataset
        encoder : Encoder, optional
            Default `TextureEncoder` of as many channels as the frames have.
        path : path-like
            A new folder. It appears when it is complete.
        split : str, optional
            ``<name>/<list>`` of a split stored with the dataset, or ``train`` or ``val`` of one
            made on the fly by part.
        stream : str or sequence of str, optional
            Tactile streams; default all.
        frames : int
            Salient frames a clip.
        provenance : {"human", "any"}
            Whose labels count.
        workers : int, optional
            Processes that encode; None takes all cores.
        engine : Engine, optional
            Where the clips are encoded; default processes of this machine.
        on_corrupt : {"raise", "skip"}
            Stop at a clip that cannot be decoded, or leave it out and count it in ``index.json``.
        on_damaged : callable
            Told of each clip that is left out.
        on_done : callable
            Told of the clips that were read, and of all.

        Returns
        -------
        TactileIndex

        Raises
        ------
        UsageError
            The folder is there already; no clip; the encoder does not fit.
        DamagedDataError
            A frame cannot be decoded (names episode, stream and frame); or no clip can.
        """
        target = Path(path)
        if split is not None:
            from exumi_data.splits import split_ids

            dataset = dataset.select(split_ids(dataset, split, by="part"))
        encoder = encoder or _encoder_for(dataset, stream)
        with new_index(target) as partial:
            clips = encode_clips(
                dataset,
                encoder,
                stream=stream,
                frames=frames,
                provenance=provenance,
                workers=workers,
                engine=engine,
                on_corrupt=on_corrupt,
                on_done=on_done,
            )
            for clip in clips.damaged:
                on_damaged(clip)
            source = SourceStatement(
                name=dataset.metadata.name,
                digest=dataset.fingerprint,
                split=split,
                clips=len(clips),
                damaged=len(clips.damaged),
            )
            fill_index(partial, clips, encoder, frames=frames, source=source)
        return cls(target, encoder=encoder)

    def _reload(self) -> None:
        self._contents = open_contents(self.path, self._backend, self._contents.segments)

    def __len__(self) -> int:
        return len(self._contents)

    def __repr__(self) -> str:
        return f"<TactileIndex {str(self.path)!r}, {len(self)} entries>"

    @property
    def document(self) -> IndexDocument:
        """What ``index.json`` says."""
        return self._contents.document

    def info(self) -> IndexInfo:
        """Return what the index holds, and what it was made from."""
        return self._contents.info()

    def entries(self) -> list[Entry]:
        """Return all entries that count, in the order of their rows."""
        return self._contents.entries()

    def holds(self, origins: Sequence[str]) -> bool:
        """Whether a clip is in the index.

        A clip of the build is, even if it was forgotten: it shaped the space in which clips are
        compared. One that was taught is not, once it is forgotten.

        Parameters
        ----------
        origins : sequence of str
            What the clip can be told by: ``Embedding.origins``.
        """
        return self._contents.holds(origins)

    def embed(
        self, frames: np.ndarray, reference: np.ndarray | None = None, *, kind: Kind = (None, None)
    ) -> Embedding:
        """Encode a clip with the index's encoder.

        Parameters
        ----------
        frames : (N, H, W, C) uint8
            Salient frames, as `Clips.read` gives them.
        reference : (H, W, C) uint8, optional
            The image without contact.
        kind : (str or None, str or None)
            Sensor model and pad type.

        Returns
        -------
        Embedding

        Raises
        ------
        UsageError
            The index was opened without its encoder, or the arrays do not fit it.
        """
        if self.encoder is None:
            raise UsageError(
                f"the index was made with {self.document.encoder.name}, which is not at hand",
                where=self.path,
                fix="Open it with encoder=, made of the same weights.",
            )
        return embed(self.encoder, frames, reference, kind=kind)

    def place(self, embeddings: Sequence[Embedding]) -> np.ndarray:
        """Map embeddings into the space of the index.

        Parameters
        ----------
        embeddings : sequence of Embedding

        Returns
        -------
        (B, d) float32
            Of length 1.

        Raises
        ------
        UsageError
            They are of another encoder.
        """
        width = self.document.encoder.dimension
        for embedding in embeddings:
            self._check_encoder(embedding.encoder)
            if embedding.vector.shape != (width,) or not np.isfinite(embedding.vector).all():
                raise UsageError(
                    f"an embedding of {embedding.vector.shape}, expected ({width},) finite numbers"
                )
        vectors = np.array([embedding.vector for embedding in embeddings], dtype=np.float32)
        vectors = vectors.reshape(len(embeddings), width)
        return self._contents.place(vectors)

    def search(
        self, embeddings: Sequence[Embedding] | np.ndarray, k: int = 5
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find the nearest entries of many queries at once.

        Parameters
        ----------
        embeddings : sequence of Embedding, or (B, d) float32
            Or what `place` made of them.
        k : int

        Returns
        -------
        similarity : (B, k) float32
            Cosines, falling. k is smaller in an index with fewer entries.
        row : (B, k) int64
            Rows for `entry`; −1 where FAISS found none.

        Raises
        ------
        UsageError
            They are of another encoder, or of another dimension.
        """
        queries = embeddings if isinstance(embeddings, np.ndarray) else self.place(embeddings)
        if queries.ndim != 2 or queries.shape[1] != self.document.dimension:
            width = self.document.dimension
            raise UsageError(f"queries of {queries.shape}, expected (B, {width})")
        if k < 1:
            raise UsageError(f"k is {k}, not a positive number")
        return self._contents.search.nearest(np.ascontiguousarray(queries, dtype=np.float32), k)

    def entry(self, row: int) -> Entry:
        """Return the entry of a row.

        Parameters
        ----------
        row : int
        """
        return self._contents.entry(row)

    def query(
        self,
        touched: np.ndarray | Embedding,
        reference: np.ndarray | None = None,
        *,
        k: int = 5,
        ranking: Ranking = "similarity",
        unique: Unique = "object",
        samples: int | None = None,
        kind: Kind = (None, None),
    ) -> list[Match]:
        """Find what felt most alike.

        Parameters
        ----------
        touched : (N, H, W, C) uint8 or Embedding
            Salient frames of a clip, or what `embed` made of them.
        reference : (H, W, C) uint8, optional
            The image without contact, with frames.
        k : int
            At most so many objects, parts or clips.
        ranking : {"similarity", "matches"}
            By the most similar clip of each (as Octopi-1.5's code does), or by how many of the
            nearest clips are of each, then by similarity (as its text says).
        unique : {"object", "part", "clip"}
            What is named once.
        samples : int, optional
            How many nearest clips are looked at. Default: of ``similarity`` as many as it takes
            to find k, of ``matches`` k. Octopi's is 5.
        kind : (str or None, str or None)
            Sensor model and pad type, with frames.

        Returns
        -------
        list of Match
            The best first.

        Raises
        ------
        UsageError
            An option is not supported; the embedding is of another encoder.
        """
        made = touched
        if not isinstance(made, Embedding):
            made = self.embed(made, reference, kind=kind)
        vector = self.place([made])
        return self.ranked(vector, k=k, ranking=ranking, unique=unique, samples=samples)

    def ranked(
        self,
        vector: np.ndarray,
        *,
        k: int,
        ranking: Ranking,
        unique: Unique,
        samples: int | None = None,
    ) -> list[Match]:
        """Find what is nearest to a vector of `place`.

        Parameters
        ----------
        vector : (1, d) float32
        k : int
        ranking : {"similarity", "matches"}
        unique : {"object", "part", "clip"}
        samples : int, optional
            As of `query`.

        Returns
        -------
        list of Match
            The best first.
        """
        check_choice("ranking", ranking, RANKINGS)
        check_choice("unique", unique, UNIQUE)
        if k < 1 or (samples is not None and samples < 1):
            raise UsageError(f"k is {k} and samples {samples}; both must be positive")
        if samples is None and ranking == "matches":
            samples = k
        similarity, rows, groups = look(
            lambda count: self.search(vector, count), self._contents.codes(unique), k, samples
        )
        first, matches = rank(groups, similarity, ranking)
        return [
            Match(self.entry(int(rows[at])), float(similarity[at]), int(count))
            for at, count in zip(first[:k], matches[:k], strict=True)
        ]

    def line(
        self,
        matches: Sequence[Match],
        *,
        ranking: Ranking = "similarity",
        unique: Unique = "object",
    ) -> str:
        """Write matches as the line that a tactile-language model reads; it names the ranking.

        Parameters
        ----------
        matches : sequence of Match
            Of `query`, called with the same options.
        ranking : {"similarity", "matches"}
        unique : {"object", "part", "clip"}

        Returns
        -------
        str
            Such as ``Most similar objects (in order of decreasing similarity): a sponge (soft).``
        """
        check_choice("ranking", ranking, RANKINGS)
        check_choice("unique", unique, UNIQUE)
        return similar_line(matches, ranking=ranking, unique=unique)

    def teach(
        self,
        clips: Sequence[Example],
        *,
        name: str,
        part_id: str | None = None,
        object_id: str | None = None,
        adjectives: Sequence[str] = (),
        labels: Mapping[str, float] | None = None,
        provenance: Provenance = "human",
    ) -> Entry:
        """Teach an object by one or some clips: no training, one vector more.

        Their vectors are averaged, as in Octopi-1.5. `forget` undoes it.

        Parameters
        ----------
        clips : sequence of Embedding or (frames, reference)
        name : str
            Of the object.
        part_id, object_id : str, optional
        adjectives : sequence of str
        labels : mapping of str to float, optional
            Ratings from 0 to 10.
        provenance : {"human", "model"}
            Who says so.

        Returns
        -------
        Entry

        Raises
        ------
        UsageError
            No clip; an option is not supported; an embedding is of another encoder; another
            process holds the index.
        """
        made = [one if isinstance(one, Embedding) else self.embed(*one) for one in clips]
        entry = taught_entry(
            made,
            name=name,
            part_id=part_id,
            object_id=object_id,
            adjectives=adjectives,
            labels=labels or {},
            provenance=provenance,
        )
        vector = unit(self.place(made).mean(axis=0, keepdims=True))
        with changing(self.path) as document:
            self._check_same_space(document)
            changes.add(self.path, document, vector, [entry])
        self._reload()
        return entry

    def forget(
        self, name: str | None = None, *, entry: str | None = None, built: bool = False
    ) -> list[Entry]:
        """Forget what was taught.

        Parameters
        ----------
        name : str, optional
            Of the object: all that was taught under it.
        entry : str, optional
            The id of one entry instead.
        built : bool
            Also entries that were built from a dataset.

        Returns
        -------
        list of Entry
            What was forgotten.

        Raises
        ------
        UsageError
            There is nothing of that name; another process holds the index.
        """
        if (name is None) == (entry is None):
            raise UsageError("forget by name or by entry, one of the two")

        column, value = ("id", entry) if name is None else ("name", name)
        with changing(self.path) as document:
            gone = changes.forget(self.path, document, column, str(value), built=built)
        self._reload()
        if not gone:
            raise UsageError(
                f"nothing was taught as {value!r}",
                where=self.path,
                fix="See what there is with: exumi index info. With built=True (--built), entries "
                "of the dataset are forgotten, too.",
            )
        return gone

    def _check_same_space(self, document: IndexDocument) -> None:
        if document.encoder != self.document.encoder or document.source != self.document.source:
            raise UsageError("the index was replaced by another one", fix="Open it again.")

    def _check_encoder(self, digest: str) -> None:
        mine = self.document.encoder.digest
        if digest != mine:
            raise UsageError(
                f"the index was made with {mine}, this is of {digest}: their vectors cannot be "
                "compared",
                where=self.path,
                fix="Use the encoder of the index, or build another index.",
            )


def _built_in(digest: str) -> Encoder | None:
    from exumi_loaders.texture import TextureEncoder

    return next((e for e in map(TextureEncoder, (1, 3)) if e.digest == digest), None)


def _encoder_for(dataset: "Dataset", stream: str | Sequence[str] | None) -> Encoder:
    from exumi_loaders.clips import Clips
    from exumi_loaders.texture import TextureEncoder

    return TextureEncoder(Clips(dataset, stream=stream).table[0].shape[2])
