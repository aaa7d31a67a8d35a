"""Choice of a reference image: which frames of a clip show the sensor without contact."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from exumi_data.tactile.images import Float32Array, UInt8Array

__all__ = [
    "REFERENCE_METHOD",
    "ReferenceChoice",
    "choose_reference",
    "reference_image",
    "thumbnail",
]

REFERENCE_METHOD = "exumi-reference/1"

_THUMBNAIL_PIXELS = 4800  # 60 x 80: contact a few pixels wide is still seen, noise is averaged
_CHANGED = 3  # grey levels
_SAME_STATE = 0.01  # two frames show the same state if fewer pixels than this share changed
_REST_FRAMES = 6  # still this long is rest; hand-held contact rarely is still for as long
_REFERENCE_FRAMES = 5  # median of so many removes the codec's noise
_REFERENCE_SPAN = 32  # frames: the median is taken near in time, before light or gel can drift
_RECURRENCE_WEIGHT = 0.5
_END_WEIGHT = 0.5


@dataclass(frozen=True, kw_only=True)
class ReferenceChoice:
    """Which frames to make a reference image from; made by `choose_reference`.

    Attributes
    ----------
    method
        ``"selected"``: the frames show the sensor at rest. ``"estimated"``: no such frames were
        found, and these are the least touched; the reference may contain contact.
    frames
        Indices of one to five frames, ascending; hand them to `reference_image`.
    score
        How much less structure the chosen state has than the others, -1 to 1; 0 where nothing
        changes.
    rest_frames
        How many frames in a row the chosen state lasts.
    reason
        Why, in a few words for people.
    """

    method: Literal["selected", "estimated"]
    frames: tuple[int, ...]
    score: float
    rest_frames: int
    reason: str

    @property
    def contact_free(self) -> bool:
        """Whether the frames were found to be free of contact."""
        return self.method == "selected"


def thumbnail(grey: UInt8Array, pixels: int = _THUMBNAIL_PIXELS) -> UInt8Array:
    """Shrink a frame to what `choose_reference` needs, so that a clip need not stay in memory.

    Parameters
    ----------
    grey
        (H, W) uint8.
    pixels
        How many the result has, about; at least 1.

    Returns
    -------
    (h, w) uint8
        Means over squares of n x n pixels, to a grey level or so, n an integer such that h * w
        is about `pixels` (by default 240 x 320 gives 60 x 80); the last H mod n rows and W mod n
        columns are left out.

    Raises
    ------
    ValueError
        If the frame is empty, or shape or dtype is something else.
    """
    import cv2

    if grey.dtype != np.uint8 or grey.ndim != 2 or grey.size == 0:
        raise ValueError(f"a grey frame must be (H, W) uint8, not {grey.shape} {grey.dtype}")
    n = max(1, min(math.isqrt(grey.size // pixels), *grey.shape))
    height, width = grey.shape[0] // n, grey.shape[1] // n
    image = np.ascontiguousarray(grey[: height * n, : width * n])
    # OpenCV halves four times as fast as it divides by any other number.
    while n > 1:
        step = 2 if n % 2 == 0 else n
        n //= step
        target = (width * n, height * n)
        image = np.asarray(cv2.resize(image, target, interpolation=cv2.INTER_AREA), np.uint8)
    return image


def choose_reference(thumbnails: UInt8Array | Sequence[UInt8Array]) -> ReferenceChoice:
    """Find the frames of a clip that show the sensor without contact; ``exumi-reference/1``.

    Contact presses structure into a smooth image, comes and goes, and is seldom still. So, among
    up to 48 quiet frames spread over the clip, each pair that differs is compared where it
    differs: the frame with less fine structure there is nearer to rest. The best frame by this,
    by how often its state recurs, and by whether the clip begins or ends with it, is the
    candidate; it is at rest if its state lasts for at least six frames. The reference is then
    taken from the earliest such time, away from the contact that borders on it.

    What it cannot know: an object that is held still from the first frame to the last looks like
    part of the sensor. A clip in which nothing changes is therefore ``"estimated"``.

    Parameters
    ----------
    thumbnails
        (N, h, w) uint8 grey frames in time order, as `thumbnail` makes them. Larger frames are
        shrunk here.

    Returns
    -------
    ReferenceChoice
        The frames, and whether they are free of contact.

    Raises
    ------
    ValueError
        If there is no frame, or frames differ in shape or are not uint8.
    """
    frames = _as_thumbnails(thumbnails)
    samples = _quiet_samples(frames)
    changed, lead = _compare(frames[samples])
    same = changed < _SAME_STATE
    lead_mean = np.where(same, 0.0, lead).sum(1) / np.maximum((~same).sum(1), 1)
    if same.all():
        return _estimated(samples[:_REFERENCE_FRAMES], 0.0, len(frames), "nothing changes")
    best = int(_merit(lead_mean, same).argmax())
    score = float(lead_mean[best])
    first, end = _rest(frames, int(samples[best]))
    if end - first < _REST_FRAMES:
        least = samples[np.argsort(-lead_mean, kind="stable")[:_REFERENCE_FRAMES]]
        return _estimated(least, score, end - first, f"no rest of {_REST_FRAMES} frames")
    return ReferenceChoice(
        method="selected",
        frames=_away_from_contact(first, end, len(frames)),
        score=score,
        rest_frames=end - first,
        reason=f"at rest for {end - first} frames from frame {first}",
    )


def reference_image(frames: Sequence[UInt8Array]) -> UInt8Array:
    """Make a reference image: the median of a few frames, pixel by pixel.

    Parameters
    ----------
    frames
        One or more (H, W) or (H, W, C) uint8 frames of one shape.

    Returns
    -------
    (H, W) or (H, W, C) uint8
        Median over the frames; of an even number, the lower of the two in the middle, so that
        every value was seen.

    Raises
    ------
    ValueError
        If there is no frame, or frames differ in shape or are not uint8.
    """
    _check_frames(frames)
    # Bubble sort by whole images: for five frames some fifty times faster than numpy.median.
    ordered = [np.asarray(frame) for frame in frames]
    for end in range(len(ordered) - 1, 0, -1):
        for i in range(end):
            low = np.minimum(ordered[i], ordered[i + 1])
            ordered[i + 1] = np.maximum(ordered[i], ordered[i + 1])
            ordered[i] = low
    return ordered[(len(ordered) - 1) // 2].copy()


def _estimated(
    frames: npt.NDArray[np.intp], score: float, rest_frames: int, reason: str
) -> ReferenceChoice:
    return ReferenceChoice(
        method="estimated",
        frames=tuple(sorted(int(i) for i in frames)),
        score=score,
        rest_frames=rest_frames,
        reason=reason,
    )


def _as_thumbnails(images: UInt8Array | Sequence[UInt8Array]) -> UInt8Array:
    """Stack frames to (N, h, w) uint8, shrunk where they are large."""
    _check_frames(images)
    if images[0].ndim != 2:
        raise ValueError(f"grey frames must be of shape (h, w), not {images[0].shape}")
    if images[0].size >= 4 * _THUMBNAIL_PIXELS:
        return np.stack([thumbnail(image) for image in images])
    return np.ascontiguousarray(images, dtype=np.uint8)


def _quiet_samples(frames: UInt8Array) -> npt.NDArray[np.intp]:
    """Pick the frame with the least change around it in each of up to 48 equal parts."""
    import cv2

    n = len(frames)
    step = np.array([cv2.norm(a, b, cv2.NORM_L1) for a, b in itertools.pairwise(frames)])
    change = np.maximum(np.append(step, 0), np.insert(step, 0, 0))
    parts = min(n, int(np.clip(n // 5, 16, 48)))
    edges = np.linspace(0, n, parts + 1).astype(np.intp)
    return np.array([a + change[a:b].argmin() for a, b in itertools.pairwise(edges)], np.intp)


def _structure(frame: UInt8Array) -> Float32Array:
    """Magnitude of detail some 3 to 9 pixels wide; lighting and noise are finer or coarser."""
    import cv2

    image = frame.astype(np.float32)
    detail = cv2.blur(image, (3, 3)) - cv2.blur(image, (9, 9))
    return np.asarray(np.abs(detail), np.float32)


def _compare(
    frames: UInt8Array,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Compare frames pair by pair.

    Returns
    -------
    changed : (K, K)
        Share of pixels that differ.
    lead : (K, K)
        ``(s[j] - s[i]) / (s[j] + s[i])`` with s the structure where i and j differ: positive
        where i is the smoother one.
    """
    k = len(frames)
    pixels = frames.reshape(k, -1)
    structure = np.stack([_structure(frame).ravel() for frame in frames])
    changed, lead = np.zeros((k, k)), np.zeros((k, k))
    for i in range(k - 1):
        rest = pixels[i + 1 :]
        difference = np.maximum(rest, pixels[i]) - np.minimum(rest, pixels[i])
        where = (difference >= _CHANGED).astype(np.float32)
        own = np.einsum("jp,p->j", where, structure[i])
        other = np.einsum("jp,jp->j", where, structure[i + 1 :])
        changed[i, i + 1 :] = where.mean(1)
        lead[i, i + 1 :] = (other - own) / np.maximum(other + own, 1e-6)
    return changed + changed.T, lead - lead.T


def _merit(
    lead_mean: npt.NDArray[np.float64], same: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float64]:
    """Score samples: smoothness, recurrence, and beginning or ending the clip.

    Smoothness is scaled to its own range, because how much structure contact adds depends on
    how much the sensor shows anyway.
    """
    smooth = lead_mean / max(float(np.ptp(lead_mean)), 0.02)
    recurrence = (same.sum(1) - 1) / max(len(same) - 1, 1)
    end = same[:, 0] | same[:, -1]
    merit = smooth + _RECURRENCE_WEIGHT * recurrence + _END_WEIGHT * end
    return np.asarray(merit, np.float64)


def _rest(frames: UInt8Array, candidate: int) -> tuple[int, int]:
    """First and end of the earliest long enough run in the candidate's state, else the longest."""
    pixels = frames.reshape(len(frames), -1)
    base = pixels[candidate]
    changed = (np.maximum(pixels, base) - np.minimum(pixels, base)) >= _CHANGED
    state = np.count_nonzero(changed, axis=1) < _SAME_STATE * base.size
    edges = np.flatnonzero(np.diff(np.concatenate(([False], state, [False])).astype(np.int8)))
    first, end = edges[::2], edges[1::2]
    length = end - first
    run = int((length >= min(_REST_FRAMES, length.max())).argmax())
    return int(first[run]), int(end[run])


def _away_from_contact(first: int, end: int, n: int) -> tuple[int, ...]:
    """Up to five frames of the rest ``[first, end)`` of a clip of n frames, far from contact."""
    length = end - first
    after_contact, before_contact = first > 0, end < n
    if before_contact and not after_contact:
        start, stop = first, end - length // 2
    elif after_contact and not before_contact:
        start, stop = first + length // 2, end
    else:
        start, stop = first + length // 4, end - length // 4
    surplus = max(0, stop - start - _REFERENCE_SPAN)
    if before_contact and not after_contact:
        stop -= surplus
    elif after_contact and not before_contact:
        start += surplus
    else:
        start, stop = start + surplus // 2, stop - (surplus - surplus // 2)
    chosen = np.unique(np.linspace(start, stop - 1, _REFERENCE_FRAMES).round().astype(int))
    return tuple(int(i) for i in chosen)


def _check_frames(frames: UInt8Array | Sequence[UInt8Array]) -> None:
    """Check that there is at least one frame, and that all are uint8 and of one shape."""
    if len(frames) == 0:
        raise ValueError("there is no frame to make a reference from")
    for i, frame in enumerate(frames):
        if frame.dtype != np.uint8 or frame.shape != frames[0].shape:
            raise ValueError(
                f"frame {i} is {frame.shape} {frame.dtype}; expected {frames[0].shape} uint8"
            )
