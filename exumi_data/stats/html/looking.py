"""Looking at one episode: decodes a few frames of each tactile stream, each once, one at a time."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.episode import Episode, StreamView, open_episode
from exumi_data.stats.episode import active_above
from exumi_data.stats.html.choosing import Job
from exumi_data.stats.html.reading import even
from exumi_data.tactile import ACTIVITY_SIZE, active_pixels, paint_change, to_grey
from exumi_data.time import nearest_indices

__all__ = ["GRID", "Looked", "Picture", "Tile", "Touched", "look"]

GRID = 32
"""Cells along each edge of a contact map."""

_BLOCK = ACTIVITY_SIZE // GRID
_WIDE = 208  # pixels of a picture
_QUALITY = 82
_FINGERS = 2
_FAR_NS = 2**61
_GROUND, _BRIGHTER, _DARKER = (24, 28, 34), (255, 176, 59), (86, 160, 255)

UInt8Array = npt.NDArray[np.uint8]
Counts = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A small JPEG file, and what it shows."""

    words: str
    jpeg: bytes
    width: int
    height: int
    camera: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """The strongest contact of an episode.

    Attributes
    ----------
    name, episode : str
    time_s : float
        Since the episode's first sample.
    activity : float or None
        Of the stream that was touched most.
    pictures : tuple of Picture
    """

    name: str
    episode: str
    time_s: float
    activity: float | None
    pictures: tuple[Picture, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Touched:
    """Where one tactile stream was touched.

    Attributes
    ----------
    stream : str
    frames : int
        Active frames that were decoded.
    counts : (GRID, GRID) int64
        Active pixels of each cell, over these.
    shape : (int, int)
        Height and width of its frames.
    """

    stream: str
    frames: int
    counts: Counts
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """What one episode gave."""

    decoded: int
    touched: tuple[Touched, ...]
    tile: Tile | None


@dataclass(frozen=True, slots=True)
class _Moment:
    time_ns: int
    activity: float | None


def look(job: Job) -> Looked:
    """Look at an episode.

    Parameters
    ----------
    job : Job

    Returns
    -------
    Looked

    Raises
    ------
    DamagedDataError
        A frame or an array cannot be read.
    """
    with open_episode(job.path) as episode:
        streams = [s for s in episode.of_kind("tactile") if len(s)]
        moment = _moment(streams) if job.rank is not None else None
        seen = []
        for stream in streams:
            one = _see(episode, stream, job.frames, moment, seek=job.rank is not None)
            moment = moment or one.moment
            seen.append(one)
        tile = None
        if job.rank is not None and moment is not None:
            tile = _tile(episode, job, moment, seen)
        decoded = sum(one.decoded for one in seen)
        touched = tuple(one.touched for one in seen if one.touched is not None)
        return Looked(decoded=decoded, touched=touched, tile=tile)


def _moment(streams: list[StreamView]) -> _Moment | None:
    """Return when an episode is touched most, by its stored activity.

    Where none is stored but a reference is there, None: it is found while frames are looked at.
    Where there is no reference either, the middle.
    """
    best: _Moment | None = None
    for stream in streams:
        activity = stream.activity
        if activity is None:
            continue
        index = int(np.nan_to_num(activity).argmax())
        value = float(activity[index])
        if best is None or value > (best.activity or 0):
            best = _Moment(int(stream.time[index]), value)
    if best is None and streams and all(stream.reference is None for stream in streams):
        best = _Moment(int(streams[0].time[len(streams[0]) // 2]), None)
    return best


@dataclass(frozen=True, slots=True)
class _Seen:
    stream: str
    decoded: int
    touched: Touched | None
    shown: UInt8Array | None
    reference: UInt8Array | None
    moment: _Moment | None


def _see(
    episode: Episode, stream: StreamView, wanted: int, moment: _Moment | None, *, seek: bool
) -> _Seen:
    """Look at frames of one stream; `seek` the strongest contact among them if it is not known."""
    reference = stream.reference
    if reference is None:
        at = _nearest(stream, moment)
        shown = None if at is None else stream.frames[at]
        return _Seen(stream.name, int(shown is not None), None, shown, None, None)
    base = to_grey(reference)
    at = _nearest(stream, moment)
    counted = _in_contact(episode, stream, max(wanted, 1) if seek else wanted)
    measured = stream.activity is not None
    # Without stored activity, what was chosen need not be in contact. And nothing says how the
    # reference became grey: frames take the same way then, from their colours.
    least = 0.0 if measured else active_above(episode, stream.name)
    counts = np.zeros((GRID, GRID), np.int64)
    frames, shown, found = 0, None, None
    chosen = sorted(counted | ({at} if at is not None else set()))
    for index in chosen:
        colour = stream.frames[index] if index == at or not measured else None
        if index == at:
            shown = colour
        if index not in counted:
            continue
        grey = stream.frames.read([index], grey=True)[0, ..., 0] if colour is None else colour
        active = active_pixels(to_grey(grey), base)
        share = float(active.mean())
        if share > least or measured:
            frames += 1
            counts += _by_cell(active)
        if seek and moment is None and (found is None or share > (found.activity or 0)):
            found, shown = _Moment(int(stream.time[index]), share), colour
    touched = Touched(
        stream=stream.name, frames=frames, counts=counts, shape=(base.shape[0], base.shape[1])
    )
    return _Seen(stream.name, len(chosen), touched, shown, reference, found)


def _nearest(stream: StreamView, moment: _Moment | None) -> int | None:
    if moment is None:
        return None
    return int(nearest_indices(stream.time, np.array([moment.time_ns]), _FAR_NS)[0])


def _by_cell(active: npt.NDArray[np.bool_]) -> Counts:
    # Rows first: their sums are long runs in memory, which is twenty times as fast.
    rows = active.view(np.uint8).reshape(GRID, _BLOCK, ACTIVITY_SIZE).sum(axis=1, dtype=np.uint8)
    return np.asarray(rows.reshape(GRID, GRID, _BLOCK).sum(axis=2), np.int64)


def _in_contact(episode: Episode, stream: StreamView, wanted: int) -> set[int]:
    """Choose frames in contact, evenly; any frames where no activity is stored."""
    activity = stream.activity
    if activity is None:
        return set(even(len(stream), wanted).tolist())
    active = np.flatnonzero(activity > active_above(episode, stream.name))
    return set(active[even(len(active), wanted)].tolist())


def _tile(episode: Episode, job: Job, moment: _Moment, seen: list[_Seen]) -> Tile:
    pictures = []
    camera = next((s for s in episode.of_kind("rgb") if len(s)), None)
    if camera is not None:
        index = int(nearest_indices(camera.time, np.array([moment.time_ns]), _FAR_NS)[0])
        pictures.append(_picture(camera.name, camera.frames[index], camera=True))
    for one in seen[:_FINGERS]:
        if one.shown is None:
            continue
        pictures.append(_picture(one.stream, one.shown))
        if one.reference is not None:
            change = paint_change(  # and only then made small: fine texture would cancel out
                one.shown,
                one.reference,
                ground=_GROUND,
                brighter=_BRIGHTER,
                darker=_DARKER,
            )
            pictures.append(_picture(f"{one.stream}, change", change))
    begins = [int(s.rows("time", 0, 1)[0]) for s in episode.streams.values() if len(s)]
    return Tile(
        name=job.name,
        episode=episode.id,
        time_s=(moment.time_ns - min(begins)) * 1e-9,
        activity=moment.activity,
        pictures=tuple(pictures),
    )


def _small(image: UInt8Array) -> UInt8Array:
    """Make an image as wide as pictures are, (h, w, 1|3) uint8."""
    import cv2

    height, width = image.shape[:2]
    if width <= _WIDE:
        return image
    size = (_WIDE, max(1, round(height * _WIDE / width)))
    smaller = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(smaller, np.uint8).reshape(size[1], size[0], image.shape[2])


def _picture(words: str, image: UInt8Array, *, camera: bool = False) -> Picture:
    from exumi_data.store import jpeg

    small = np.ascontiguousarray(_small(image))
    height, width = small.shape[:2]
    file = jpeg.encode(small, _QUALITY)
    return Picture(words=words, jpeg=file, width=width, height=height, camera=camera)
