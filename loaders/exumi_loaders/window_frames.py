"""Frames of a batch of windows, decoded in place; and what is done where they are damaged."""

from typing import Literal, NamedTuple

import numpy as np

from exumi_data.errors import ChangedDataError, DamagedDataError
from exumi_data.store.images import Frames
from exumi_loaders.readers import FrameReaders

__all__ = ["OnCorrupt", "Outcome", "read_frames"]

OnCorrupt = Literal["raise", "skip", "substitute"]


class Outcome(NamedTuple):
    """What became of the frames that were asked for, (B, K) bool each."""

    there: np.ndarray
    """Decoded."""
    damaged: np.ndarray
    """Asked for, and damaged: black."""


def read_frames(  # a batch, where it goes, and what to do
    readers: FrameReaders,
    stream: str,
    episodes: np.ndarray,
    frames: np.ndarray,
    rows: np.ndarray,
    out: np.ndarray,
    reference: np.ndarray | None,
    *,
    on_corrupt: OnCorrupt,
) -> Outcome:
    """Decode frames of one stream into a batch.

    Parameters
    ----------
    readers : FrameReaders
    stream : str
    episodes : (B,) int
    frames : (B, K) int
        -1 leaves a frame black.
    rows : (B,) int
        Where in the batch each window is.
    out : (N, K, H, W, C) uint8
    reference : (N, H, W, C) uint8, optional
    on_corrupt : {"raise", "skip", "substitute"}
        ``raise`` stops at the first damaged frame; the others make it black and say so.

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
    damaged = np.zeros(frames.shape, dtype=bool)
    missing = np.asarray(frames < 0)
    whole = np.asarray(~missing.any(axis=1))
    for position, (episode, row) in enumerate(zip(episodes.tolist(), rows.tolist(), strict=True)):
        wanted = frames[position]
        if not whole[position]:
            out[row] = 0
            if reference is None and missing[position].all():
                continue  # nothing is opened, either
        try:
            source, image = readers.get(episode, stream)
        except DamagedDataError as error:
            if on_corrupt == "raise" or isinstance(error, ChangedDataError):
                raise
            out[row] = 0
            if reference is not None:
                reference[row] = 0
            damaged[position] = ~missing[position]
            continue
        if reference is not None and image is not None:
            reference[row] = _like(image, reference.shape[-1])
        if whole[position] and _read(source, wanted, out[row]):
            continue
        for k in _read_what_is_there(source, wanted, out[row]):
            if on_corrupt == "raise":
                raise _located(source, f"{readers.location(episode)}, stream {stream}", wanted[k])
            damaged[position, k] = True
    return Outcome(~(missing | damaged), damaged)


def _read(source: Frames, wanted: np.ndarray, out: np.ndarray) -> bool:
    """Decode frames; return whether all of them are sound."""
    try:
        source.read_into(wanted.tolist(), out)
    except ChangedDataError:
        raise
    except DamagedDataError:
        return False
    return True


def _read_what_is_there(source: Frames, wanted: np.ndarray, out: np.ndarray) -> list[int]:
    """Decode the frames that are there and sound; return the positions of damaged ones."""
    there = np.flatnonzero(wanted >= 0)
    if not len(there):
        return []
    run = slice(there[0], there[-1] + 1)
    if len(there) == run.stop - run.start and _read(source, wanted[run], out[run]):
        return []
    out[:] = 0
    bad = []
    for k in there.tolist():
        if not _read(source, wanted[k : k + 1], out[k : k + 1]):
            out[k] = 0
            bad.append(k)
    return bad


def _located(source: Frames, where: str, frame: int) -> DamagedDataError:
    """Say which frame it is, whatever finds the damage."""
    try:
        source.read_into([frame], np.empty((1, *source.shape[1:]), dtype=np.uint8))
    except DamagedDataError as error:
        what = error.what.removeprefix(f"frame {frame}").lstrip(": ")
        return DamagedDataError(what, where=f"{where}, frame {frame}", fix=error.fix)
    # It was damaged a moment ago: somebody is writing to it.
    return ChangedDataError("changed while it was read", where=f"{where}, frame {frame}")


def _like(reference: np.ndarray, channels: int) -> np.ndarray:
    if reference.shape[2] == channels:
        return reference
    from exumi_data.tactile import to_grey  # OpenCV, only for mixed channels

    return np.asarray(to_grey(reference)[..., None])
