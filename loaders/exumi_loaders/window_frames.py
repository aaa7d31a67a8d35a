"""Frames of a batch of windows, decoded in place or taken as files; what is done at damage."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from exumi_data.errors import ChangedDataError, DamagedDataError
from exumi_data.store import jpeg
from exumi_data.store.images import Frames
from exumi_loaders.readers import FrameReaders

__all__ = ["OnCorrupt", "Outcome", "as_channels", "read_frames"]

OnCorrupt = Literal["raise", "skip", "substitute"]

Read = Callable[[Frames, np.ndarray, np.ndarray], None]
"""Read frames (K,) of a stream into a buffer of as many."""


class Outcome(NamedTuple):
    """What became of the frames that were asked for, (B, K) bool each."""

    there: np.ndarray
    """Decoded, or taken as files."""
    damaged: np.ndarray
    """Asked for, and damaged: black, or no file."""


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
    """Decode frames of one stream into a batch, or take them as the JPEG files that they are.

    Parameters
    ----------
    readers : FrameReaders
    stream : str
    episodes : (B,) int
    frames : (B, K) int
        -1 leaves a frame black.
    rows : (B,) int
        Where in the batch each window is.
    out : (N, K, H, W, C) uint8, or (N, K) object
        Objects are `bytes`, None where there is no frame. Such files are checked as far as that
        goes without decoding them: checksum, header, size and number of scans.
    reference : (N, H, W, C) uint8, optional
    on_corrupt : {"raise", "skip", "substitute"}
        ``raise`` stops at the first damaged frame; the others make it black (or None) and say so.

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
    read: Read = _decode
    nothing: int | None = 0
    if out.dtype == object:
        read, nothing = _taker(), None
    damaged = np.zeros(frames.shape, dtype=bool)
    missing = np.asarray(frames < 0)
    whole = np.asarray(~missing.any(axis=1))
    for position, (episode, row) in enumerate(zip(episodes.tolist(), rows.tolist(), strict=True)):
        wanted = frames[position]
        if not whole[position]:
            out[row] = nothing
            if reference is None and missing[position].all():
                continue  # nothing is opened, either
        try:
            source, image = readers.get(episode, stream)
        except DamagedDataError as error:
            if on_corrupt == "raise" or isinstance(error, ChangedDataError):
                raise
            out[row] = nothing
            if reference is not None:
                reference[row] = 0
            damaged[position] = ~missing[position]
            continue
        if reference is not None and image is not None:
            reference[row] = as_channels(image, reference.shape[-1])
        if whole[position] and _is_sound(read, source, wanted, out[row]):
            continue
        for k in _read_what_is_there(read, source, wanted, out[row], nothing):
            if on_corrupt == "raise":
                where = f"{readers.location(episode)}, stream {stream}, frame {wanted[k]}"
                raise _located(read, source, wanted[k : k + 1], out[row, k : k + 1], where)
            damaged[position, k] = True
    return Outcome(~(missing | damaged), damaged)


def _decode(source: Frames, wanted: np.ndarray, out: np.ndarray) -> None:
    source.read_into(wanted.tolist(), out)


def _taker() -> Read:
    """Take frames as files: one that several windows of a batch have is read once."""
    files: dict[tuple[Frames, int], bytes] = {}

    def take(source: Frames, wanted: np.ndarray, out: np.ndarray) -> None:
        _, height, width, _ = source.shape
        for k, frame in enumerate(wanted.tolist()):
            data = files.get((source, frame))
            if data is None:
                data = source.file(frame)
                # Here and not later: a decoder takes as much memory as a file claims to need.
                jpeg.check(data, (height, width))
                files[source, frame] = data
            out[k] = data

    return take


def _is_sound(read: Read, source: Frames, wanted: np.ndarray, out: np.ndarray) -> bool:
    """Read frames; return whether all of them are sound."""
    try:
        read(source, wanted, out)
    except ChangedDataError:
        raise
    except DamagedDataError:
        return False
    return True


def _read_what_is_there(
    read: Read, source: Frames, wanted: np.ndarray, out: np.ndarray, nothing: int | None
) -> list[int]:
    """Read the frames that are there and sound; return the positions of damaged ones."""
    there = np.flatnonzero(wanted >= 0)
    if not len(there):
        return []
    run = slice(there[0], there[-1] + 1)
    if len(there) == run.stop - run.start and _is_sound(read, source, wanted[run], out[run]):
        return []
    out[:] = nothing
    bad = []
    for k in there.tolist():
        if not _is_sound(read, source, wanted[k : k + 1], out[k : k + 1]):
            out[k] = nothing
            bad.append(k)
    return bad


def _located(
    read: Read, source: Frames, wanted: np.ndarray, out: np.ndarray, where: str
) -> DamagedDataError:
    """Say which frame it is, whatever finds the damage."""
    try:
        read(source, wanted, out)
    except DamagedDataError as error:
        what = error.what.removeprefix(f"frame {wanted[0]}").lstrip(": ")
        return DamagedDataError(what, where=where, fix=error.fix)
    # It was damaged a moment ago: somebody is writing to it.
    return ChangedDataError("changed while it was read", where=where)


def as_channels(image: np.ndarray, channels: int) -> np.ndarray:
    """Return an image in colour as luma, where one channel is asked for.

    Parameters
    ----------
    image : (H, W, C) uint8
    channels : int
    """
    if image.shape[2] == channels:
        return image
    from exumi_data.tactile import to_grey  # OpenCV, only for mixed channels

    return np.asarray(to_grey(image)[..., None])
