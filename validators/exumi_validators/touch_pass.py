"""Which frames of a tactile stream are looked at while they are decoded."""

import math

import numpy as np
import numpy.typing as npt

from exumi_data.model.streams import TactileStream
from exumi_data.tactile import thumbnail, to_grey
from exumi_validators.context import EpisodeContext
from exumi_validators.frame_statistics import FrameStatistics, GlanceLimits, UInt8Array
from exumi_validators.sample_flags import flagged

__all__ = ["begin_statistics", "image_of", "spread", "stored_rows"]

_MAX_IMAGE_BYTES = 64 << 20
_MAX_ROWS = 1 << 22  # 39 hours at 30 frames/s


def begin_statistics(episode: EpisodeContext, name: str) -> FrameStatistics | None:
    """Begin the statistics of a stream's frames; None for a stream that is not of touch.

    They are kept as ``episode.frame_statistics[name]``.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the stream.
    """
    stream, count = episode.streams.get(name), episode.count(name)
    if not isinstance(stream, TactileStream) or not count:
        return None
    activity = stored_rows(episode, f"derived/{name}/activity", count)
    bits = stored_rows(episode, f"streams/{name}/flags", count)
    ignored = None if bits is None else flagged(bits, "invalid")
    if activity is not None and ignored is not None:
        activity = np.where(ignored, np.nan, activity)
    reference = image_of(episode, f"streams/{name}/reference")
    thumbnail_pixels = _at_least_one(episode, "TACT-006", "thumbnail_pixels")
    small = None if reference is None else thumbnail(to_grey(reference), thumbnail_pixels)
    kept, searched = _choose(episode, count, activity)
    statistics = FrameStatistics(
        (stream.images.height, stream.images.width),
        _limits(episode, small, thumbnail_pixels),
        kept=kept,
        searched=searched,
        ignored=ignored,
        reference=small,
        coloured=reference,
    )
    episode.frame_statistics[name] = statistics
    return statistics


def _limits(
    episode: EpisodeContext, reference: UInt8Array | None, thumbnail_pixels: int
) -> GlanceLimits:
    dark = episode.limit("TACT-008", "dark_grey_level")
    if reference is not None:
        share = episode.limit("TACT-008", "dark_share_of_reference")
        dark = max(dark, share * float(reference.mean()))
    return GlanceLimits(
        dark_level=dark,
        saturated_level=episode.limit("TACT-007", "saturated_grey_level"),
        saturated_share=episode.limit("TACT-007", "saturated_share"),
        pixels=int(episode.limit("TACT-007", "pixels")),
        thumbnail_pixels=thumbnail_pixels,
        jump_rows=_at_least_one(episode, "TACT-011", "rows"),
        jump_apart_px=_at_least_one(episode, "TACT-011", "apart_px"),
    )


def _at_least_one(episode: EpisodeContext, rule: str, name: str) -> int:
    return max(1, int(episode.limit(rule, name)))


def _choose(
    episode: EpisodeContext, count: int, activity: npt.NDArray[np.floating] | None
) -> tuple[list[int], list[int]]:
    """Choose the frames to keep thumbnails of, quiet ones, and those to search, busy ones."""
    kept = _at_least_one(episode, "TACT-006", "parts")
    if activity is None:
        return spread(count, kept), spread(count, _at_least_one(episode, "TACT-011", "parts"))
    # Where it is known which frames are busy, fewer will do.
    searched = _at_least_one(episode, "TACT-011", "active_parts")
    return spread(count, kept, activity), spread(count, searched, -activity)


def spread(count: int, parts: int, cost: npt.NDArray[np.floating] | None = None) -> list[int]:
    """Choose one frame from each of some equal parts of a stream.

    Parameters
    ----------
    count : int
        Frames in all.
    parts : int
    cost : (count,) float, optional
        The frame of the least cost is chosen; NaN is never chosen. Default the middle one.

    Returns
    -------
    list of int
        Ascending; as many as there are parts, or frames if they are fewer.
    """
    edges = np.linspace(0, count, min(parts, count) + 1).astype(np.int64)
    if cost is None:
        return [(first + end) // 2 for first, end in _pairs(edges)]
    whole = np.where(np.isfinite(cost), cost, np.inf)
    found = (first + int(whole[first:end].argmin()) for first, end in _pairs(edges))
    return [int(index) for index in found if np.isfinite(whole[index])]


def _pairs(edges: npt.NDArray[np.int64]) -> list[tuple[int, int]]:
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def stored_rows(episode: EpisodeContext, path: str, count: int) -> np.ndarray | None:
    """Return an array with a number for each frame; None where it cannot be had.

    Parameters
    ----------
    episode : EpisodeContext
    path : str
    count : int
        Frames.
    """
    if count > _MAX_ROWS or path not in episode.expected_arrays:
        return None
    rows = [block for _, (block,) in episode.blocks(path)]
    found = np.concatenate(rows) if rows else np.empty(0)
    return found if found.shape == (count,) else None


def image_of(episode: EpisodeContext, path: str) -> UInt8Array | None:
    """Return an image that is stored as an array (H, W, 1|3) uint8; None where it cannot be had.

    Parameters
    ----------
    episode : EpisodeContext
    path : str
    """
    reader = episode.reader(path) if path in episode.expected_arrays else None
    if reader is None or reader.dtype != np.uint8 or len(reader.shape) != 3:
        return None
    if reader.shape[2] not in (1, 3) or not 0 < math.prod(reader.shape) <= _MAX_IMAGE_BYTES:
        return None
    rows = [block for _, (block,) in episode.blocks(path)]
    found = np.concatenate(rows) if len(rows) > 1 else rows[0] if rows else None
    # Chunks that cannot be read are the matter of other rules.
    return found if found is not None and found.shape == reader.shape else None
