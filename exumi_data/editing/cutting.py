"""A part of an episode, stream by stream: samples as they are, every one at its own rate.

Nothing is resampled or decoded. What a sample says of itself (host and device times, counters,
flags, raw values, JPEG bytes) stays as it was; only ``time`` counts from another moment, and the
clock says so.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UnsupportedError
from exumi_data.model import Annotations, Clock, Gap, VideoImages
from exumi_data.model.streams import StreamModel, images_of
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.shards import ArrayReader, open_array

__all__ = [
    "BESIDE_TIME",
    "Stretch",
    "check_known",
    "cut_annotations",
    "cut_gaps",
    "cut_stream",
    "samples_in",
]

BESIDE_TIME = ("time_host", "time_device", "sequence", "flags")
"""Arrays that any stream may have, one value a sample."""

_WHOLE = ("reference", "valid")
_OF_FRAMES = ("offset", "crc32c", "file", "pts", "keyframe")
_REPLACED = {"kind", "arrays", "clock", "gaps", "lost", "reference"}
_BLOCK_BYTES = 8 << 20
_BLOCK_ROWS = 4096


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of a session's time.

    Attributes
    ----------
    first_ns, stop_ns : int
        In the session's time; `stop_ns` is outside.
    origin_ns : int
        The session's time that is 0 in the new episode.
    """

    first_ns: int
    stop_ns: int
    origin_ns: int


def cut_stream(session: Episode, name: str, writer: EpisodeWriter, stretch: Stretch) -> int:
    """Take over the samples of a stream that lie in a stretch of time.

    Video files are never cut: of a stream that is stored as ``video``, the files that hold any
    frame of the stretch are taken over whole.

    Parameters
    ----------
    session : Episode
    name : str
        Of the stream.
    writer : EpisodeWriter
    stretch : Stretch

    Returns
    -------
    int
        Samples.

    Raises
    ------
    UnsupportedError
        The stream has an array that this library cannot cut.
    DamagedDataError
        An array cannot be read.
    """
    view = session[name]
    check_known(session, name)
    first, last = samples_in(view, stretch)
    images = images_of(view.metadata)
    fields = {
        key: getattr(view.metadata, key) for key in view.metadata.model_fields_set - _REPLACED
    }
    if isinstance(images, VideoImages):
        fields["images"] = images.model_copy(update={"files": []})
    stream = writer.add_stream(
        name,
        kind=view.kind,
        clock=_clock(view.metadata, stretch.origin_ns),
        gaps=cut_gaps(view.metadata.gaps, first, last),
        **fields,
    )
    if isinstance(images, VideoImages):
        _append_files(view, stream, images, slice(first, last), stretch.origin_ns)
    else:
        _append_samples(session, view, stream, slice(first, last), stretch.origin_ns)
    _carry_whole(view, stream, first, last)
    return last - first


def samples_in(view: StreamView, stretch: Stretch) -> tuple[int, int]:
    """Return which samples of a stream are taken over: of video files, all or none.

    Parameters
    ----------
    view : StreamView
    stretch : Stretch

    Returns
    -------
    first, last : int
        `last` is outside.
    """
    first, last = np.searchsorted(view.time, [stretch.first_ns, stretch.stop_ns]).tolist()
    if isinstance(images_of(view.metadata), VideoImages) and last > first:
        files = view.array("file")
        first = np.searchsorted(files, files[first])
        last = np.searchsorted(files, files[last - 1], side="right")
    return int(first), int(last)


def _append_samples(
    session: Episode, view: StreamView, stream: Any, chosen: slice, origin_ns: int
) -> None:
    arrays = view.metadata.arrays
    readers = {
        name: open_array(session.store, f"streams/{view.name}/{name}")
        for name in (*BESIDE_TIME, "raw", "data")
        if name in arrays
    }
    images = images_of(view.metadata)
    encoded = images is not None and images.encoding == "encoded"
    for start, stop in _blocks(readers["data"], chosen, encoded=encoded):
        beside = {
            name: reader.rows(start, stop) for name, reader in readers.items() if name != "data"
        }
        time = view.time[start:stop] - np.int64(origin_ns)
        if encoded:
            stream.append(time, [view.encoded(index) for index in range(start, stop)], **beside)
        else:
            stream.append(time, readers["data"].rows(start, stop), **beside)


def _append_files(
    view: StreamView, stream: Any, images: VideoImages, chosen: slice, origin_ns: int
) -> None:
    files, pts, keyframe = (view.array(name)[chosen] for name in ("file", "pts", "keyframe"))
    beside = {
        name: view.array(name)[chosen] for name in BESIDE_TIME if name in view.metadata.arrays
    }
    for number in np.unique(files).tolist():
        first, last = np.searchsorted(files, [number, number + 1]).tolist()
        rows = slice(first, last)
        given = {name: values[rows] for name, values in beside.items()}
        if view.metadata.clock.raw_time is not None:
            given["time"] = view.time[chosen][rows] - np.int64(origin_ns)
        stream.append_file(
            view.container(number),
            images.files[number],
            pts=pts[rows],
            keyframe=keyframe[rows].astype(np.int64) - (chosen.start + first),
            **given,
        )


def check_known(session: Episode, name: str) -> None:
    """Check that a stream has the arrays that `cut_stream` can cut, and no others.

    Parameters
    ----------
    session : Episode
    name : str
        Of the stream.

    Raises
    ------
    UnsupportedError
        It has not.
    """
    view = session[name]
    known = {"time", "data", "raw", *BESIDE_TIME, *_WHOLE}
    if view.is_image:
        known |= set(_OF_FRAMES)
    unknown = sorted(set(view.metadata.arrays) - known)
    if unknown or "data" not in view.metadata.arrays:
        what = f"has arrays that cannot be cut: {', '.join(unknown)}" if unknown else "has no data"
        raise UnsupportedError(
            f"stream {view.name!r} {what}",
            where=session.path,
            fix=f"Leave it out with: --without {view.name}",
        )


def _blocks(data: ArrayReader, chosen: slice, *, encoded: bool) -> Iterator[tuple[int, int]]:
    """Divide samples into blocks of bounded size; at least one, so that empty arrays are made."""
    rows = 64
    if not encoded:
        row_bytes = max(1, data.dtype.itemsize * int(np.prod(data.shape[1:], dtype=np.int64)))
        rows = int(np.clip(_BLOCK_BYTES // row_bytes, 1, _BLOCK_ROWS))
    for start in range(chosen.start, max(chosen.stop, chosen.start + 1), rows):
        yield start, min(start + rows, chosen.stop)


def _clock(model: StreamModel, origin_ns: int) -> Clock:
    """Return a clock whose times count from another moment, exactly."""
    clock = model.clock.model_copy(deep=True)
    if clock.raw_time is None and not isinstance(images_of(model), VideoImages):
        return clock  # its times follow from nothing
    if clock.drift_ppm:
        clock.offset_ns -= origin_ns
    else:
        clock.t_ref_ns += origin_ns
    return clock


def cut_gaps(gaps: list[Gap] | None, first: int, last: int) -> list[Gap] | None:
    """Return the gaps of samples ``first`` to ``last``; how many were lost at an edge is not known.

    Parameters
    ----------
    gaps : list of Gap or None
    first, last : int
        The samples that stay; `last` is outside.
    """
    kept = []
    for gap in gaps or ():
        if not first - 1 <= gap.after < last:
            continue
        moved = gap.model_copy(update={"after": gap.after - first})
        if gap.after in (first - 1, last - 1):
            moved = moved.model_copy(update={"lost": None})
        kept.append(moved)
    return kept or None


def _carry_whole(view: StreamView, stream: Any, first: int, last: int) -> None:
    """Carry what a stream has once: a tactile reference, the mask of taxels."""
    arrays = view.metadata.arrays
    if "valid" in arrays and view.valid is not None:
        stream.set_valid(view.valid)
    about = getattr(view.metadata, "reference", None)
    if "reference" in arrays and view.reference is not None and about is not None:
        stream.set_reference(view.reference, method=about.method)
        model = about.model_copy(deep=True)
        if about.frames is not None:
            inside = all(first <= frame < last for frame in about.frames)
            model.frames = [frame - first for frame in about.frames] if inside else None
        stream.model.reference = model


def cut_annotations(annotations: Annotations | None, stretch: Stretch) -> Annotations | None:
    """Return annotations with the segments that lie in a stretch of time, cut to it.

    Parameters
    ----------
    annotations : Annotations or None
    stretch : Stretch
    """
    if annotations is None:
        return None
    cut = annotations.model_copy(deep=True)
    if annotations.segments:
        cut.segments = [
            segment.model_copy(
                update={
                    "start_ns": max(segment.start_ns, stretch.first_ns) - stretch.origin_ns,
                    "end_ns": min(segment.end_ns, stretch.stop_ns) - stretch.origin_ns,
                }
            )
            for segment in annotations.segments
            if segment.end_ns > stretch.first_ns and segment.start_ns < stretch.stop_ns
        ] or None
    return cut
