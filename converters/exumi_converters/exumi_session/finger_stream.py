"""A finger's chunks become a tactile stream: the videos verbatim, or their frames as JPEG.

The hub's stamps are the frames' times. A frame that came late was written by the hub twice, under
one stamp; nothing is interpolated.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_converters.exumi_session.decoded import as_jpeg, jpeg_frames, note_decoding
from exumi_converters.exumi_session.plan import EpisodePlan
from exumi_converters.exumi_session.readings_stream import (
    StampedTimes,
    stamped_times,
    stream_clock,
)
from exumi_converters.exumi_session.tables import read_stamps
from exumi_converters.frame_files import add_lossy
from exumi_converters.tactile_analysis import add_salience, estimated_note, store_activity
from exumi_data.clips.clip import ClipFrames, list_frames
from exumi_data.errors import SourceError
from exumi_data.model import (
    Gap,
    InputFile,
    LossyStep,
    QualityNote,
    Sensor,
    VideoImages,
)
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import StreamWriter
from exumi_data.store.video import FramePixels, VideoDecoder
from exumi_data.tactile import (
    REFERENCE_METHOD,
    ActivityMeter,
    ReferenceChoice,
    choose_reference,
    difference_energy,
    reference_image,
    thumbnail,
)

__all__ = ["FingerFiles", "add_finger"]

Int64Array = NDArray[np.int64]
UInt8Array = NDArray[np.uint8]

_HUB = "tactile_collection_process.py of exUMI"
_MOST_THUMBNAILS = 8192


@dataclass(frozen=True, slots=True)
class FingerFiles:
    """A chunk of a finger.

    Attributes
    ----------
    number : int
    table, video : pathlib.Path
    file : InputFile
        The video's name and digest.
    """

    number: int
    table: Path
    video: Path
    file: InputFile


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """What can be used of a chunk: each frame with its stamp."""

    files: FingerFiles
    frames: ClipFrames
    stamps: Int64Array
    first: int
    """Index in the stream of its first frame."""


def add_finger(
    writer: EpisodeWriter, plan: EpisodePlan, side: str, chunks: Sequence[FingerFiles]
) -> int:
    """Write a finger's stream; nothing is written where none of its chunks can be read.

    Parameters
    ----------
    writer : EpisodeWriter
    plan : EpisodePlan
    side : {"left", "right"}
    chunks : sequence of FingerFiles
        In order.

    Returns
    -------
    int
        Frames.
    """
    name = f"tactile_{side}"
    pieces, lost = _pieces(writer, name, chunks)
    if not pieces:
        return _without_frames(writer, side)
    if plan.decode:
        return _add_decoded(writer, plan, side, pieces, lost)
    return _add_videos(writer, plan, side, pieces, lost)


def _without_frames(writer: EpisodeWriter, side: str) -> int:
    """Say that there is no stream of a finger; what was noted of it is of the episode then."""
    notes = writer.metadata.quality
    for at, note in enumerate(notes):
        if note.stream == f"tactile_{side}":
            notes[at] = note.model_copy(update={"stream": None})
    _note(writer, "no-frames", f"there is no frame of the {side} finger in this demonstration")
    return 0


def _pieces(
    writer: EpisodeWriter, stream: str, chunks: Sequence[FingerFiles]
) -> tuple[list[_Piece], list[tuple[int, str]]]:
    """Return the chunks that can be read, and after which frame others are missing."""
    pieces: list[_Piece] = []
    lost: list[tuple[int, str]] = []
    count, before = 0, None
    for files in chunks:
        if before is not None and files.number != before + 1:
            lost.append((count - 1, "a file of the hub is missing or cannot be read"))
        before = files.number
        try:
            piece = _read(writer, stream, files, pieces[0].frames if pieces else None, count)
        except SourceError as error:
            lost.append((count - 1, f"{files.video.name} cannot be read"))
            _note(writer, "unreadable-chunk", f"{files.video.name}: {error.what}", stream)
            continue
        if len(piece.stamps):
            pieces.append(piece)
            count += len(piece.stamps)
    return pieces, lost


def _read(
    writer: EpisodeWriter, stream: str, files: FingerFiles, like: ClipFrames | None, first: int
) -> _Piece:
    stamps = read_stamps(files.table)
    frames = list_frames(files.video, files.file.name, sha256=files.file.sha256)
    if like is not None and (frames.height, frames.width) != (like.height, like.width):
        raise SourceError(
            f"its frames are {frames.width}x{frames.height}, those before {like.width}x"
            f"{like.height}",
            where=files.video,
        )
    if frames.problem:
        _note(writer, "damaged-frames", f"{files.video.name}: {frames.problem}", stream)
    found = len(frames.pts)
    if found != len(stamps):
        _note(
            writer,
            "mismatched-counts",
            f"{files.video.name} has {found} frames, {files.table.name} {len(stamps)} stamps: "
            f"the first {min(found, len(stamps))} of both are taken to belong together",
            stream,
        )
    return _Piece(files, frames, stamps[:found], first)


def _note(writer: EpisodeWriter, code: str, message: str, stream: str | None = None) -> None:
    writer.metadata.quality.append(QualityNote(code=code, message=message, stream=stream))


def _note_steps(writer: EpisodeWriter, stream: str, frames: ClipFrames) -> None:
    add_lossy(
        writer,
        LossyStep(
            step="video-encode",
            stream=stream,
            detail=f"the hub decoded the camera's JPEGs and encoded the frames as "
            f"{frames.file.codec} ({frames.file.pixel_format}) as it recorded them",
            by=_HUB,
        ),
    )


def _times(
    writer: EpisodeWriter,
    plan: EpisodePlan,
    side: str,
    time_host: Int64Array,
    lost: Sequence[tuple[int, str]],
) -> tuple[StampedTimes, NDArray[np.bool_]]:
    """Return times and gaps, and which frames are the one before them once more."""
    repeated = np.concatenate([[False], np.diff(time_host) == 0])
    times = stamped_times(time_host, plan, plan.fingers[side], lost)
    count = int(np.count_nonzero(repeated))
    if count:
        writer.metadata.quality.append(
            QualityNote(
                code="repeated-frames",
                message=f"{count} of {len(repeated)} frames were written by the hub a second time "
                "under the same stamp, in place of frames that were lost",
                stream=f"tactile_{side}",
                severity="info",
            )
        )
    return times, repeated


def _fields(plan: EpisodePlan, side: str, times: StampedTimes, frames: ClipFrames) -> dict:  # type: ignore[type-arg]  # of a stream's metadata
    rate = frames.rate
    return {
        "clock": stream_clock(plan, plan.fingers[side]),
        "gaps": times.gaps or None,
        "nominal_rate": None if rate is None else f"{rate.numerator}/{rate.denominator}",
        "sensor": Sensor(model=plan.sensor, side=side),  # type: ignore[arg-type]  # left or right
    }


def _add_videos(
    writer: EpisodeWriter,
    plan: EpisodePlan,
    side: str,
    pieces: Sequence[_Piece],
    lost: Sequence[tuple[int, str]],
) -> int:
    like = pieces[0].frames
    host = np.concatenate([piece.stamps for piece in pieces])
    _note_steps(writer, f"tactile_{side}", like)
    times, repeated = _times(writer, plan, side, host, lost)
    stream = writer.add_stream(
        f"tactile_{side}",
        kind="tactile",
        images=VideoImages(
            encoding="video", height=like.height, width=like.width, channels=like.channels
        ),
        **_fields(plan, side, times, like),
    )
    for piece in pieces:
        count = len(piece.stamps)
        rows = slice(piece.first, piece.first + count)
        stream.append_file(
            piece.files.video,
            piece.frames.file,
            pts=piece.frames.pts[:count],
            keyframe=piece.frames.keyframe[:count],
            time=times.time[rows],
            time_host=times.time_host[rows],
            flags=times.flags[rows],
        )
    quiet = _quiet(pieces, ~repeated)
    if quiet is not None:
        _set_reference(writer, stream, quiet, quiet.frames)
    return len(host)


@dataclass(frozen=True, slots=True, eq=False)
class _Quiet:
    """The image without contact, and what it was made from.

    Attributes
    ----------
    choice : ReferenceChoice
    frames : list of int
        Indices among all frames of the pieces.
    image : (H, W, C) uint8
    """

    choice: ReferenceChoice
    frames: list[int]
    image: UInt8Array


def _quiet(pieces: Sequence[_Piece], usable: NDArray[np.bool_]) -> _Quiet | None:
    """Find quiet frames: among keyframes, if these tell; else all are looked at."""
    for every in (False, True):
        small: list[UInt8Array] = []
        places: list[int] = []
        for index, grey in _greys(pieces, every=every):
            if len(small) == _MOST_THUMBNAILS:
                break
            if usable[index]:
                small.append(thumbnail(grey))
                places.append(index)
        if not small:
            continue
        choice = choose_reference(small)
        if choice.contact_free or every:
            chosen = sorted(places[i] for i in choice.frames)
            return _Quiet(choice, chosen, reference_image(list(_pictures(pieces, chosen))))
    return None


def _set_reference(
    writer: EpisodeWriter, stream: StreamWriter, quiet: _Quiet, frames: Sequence[int]
) -> None:
    choice = quiet.choice
    stream.set_reference(
        quiet.image,
        method=choice.method,
        frames=frames,
        contact_free=True if choice.contact_free else None,
        algorithm=REFERENCE_METHOD,
    )
    if not choice.contact_free:
        writer.metadata.quality.append(estimated_note(stream.name, choice))


def _greys(pieces: Sequence[_Piece], *, every: bool) -> Iterator[tuple[int, UInt8Array]]:
    """Yield index in the stream and luma of frames: of all, or of keyframes."""
    pixels = FramePixels()
    for piece in pieces:
        index = {pts: i for i, pts in enumerate(piece.frames.pts[: len(piece.stamps)].tolist())}
        with VideoDecoder(str(piece.files.video), piece.files.video) as decoder:
            for frame in decoder.frames() if every else decoder.keyframes():
                at = index.get(int(frame.pts or 0))
                if at is not None:
                    yield piece.first + at, pixels.grey(frame)


def _pictures(pieces: Sequence[_Piece], chosen: Sequence[int]) -> Iterator[UInt8Array]:
    """Yield some frames, ascending, (H, W, C) uint8."""
    pixels, wanted = FramePixels(), set(chosen)
    for piece in pieces:
        own = [i - piece.first for i in wanted if 0 <= i - piece.first < len(piece.stamps)]
        if not own:
            continue
        pts = {int(piece.frames.pts[i]) for i in own}
        with VideoDecoder(str(piece.files.video), piece.files.video) as decoder:
            for frame in decoder.frames():
                if int(frame.pts or 0) in pts:
                    yield (
                        pixels.rgb(frame)
                        if piece.frames.channels == 3
                        else pixels.grey(frame)[..., None]
                    )
                    pts.discard(int(frame.pts or 0))
                if not pts:
                    break


def _add_decoded(
    writer: EpisodeWriter,
    plan: EpisodePlan,
    side: str,
    pieces: Sequence[_Piece],
    lost: Sequence[tuple[int, str]],
) -> int:
    """Write the frames of the episode's own time as JPEG; repeated ones are left out."""
    like = pieces[0].frames
    host = np.concatenate([piece.stamps for piece in pieces])
    late = plan.fingers[side].latency_ns
    inside = (host - late >= plan.start_ns) & (host - late < plan.stop_ns)
    inside &= np.concatenate([[True], np.diff(host) != 0])
    name = f"tactile_{side}"
    quiet = _quiet(pieces, inside) if inside.any() else None
    if quiet is None:
        return _without_frames(writer, side)
    _note_steps(writer, name, like)
    times, repeated = _times(writer, plan, side, host, lost)
    stream = writer.add_stream(
        name, kind="tactile", images=as_jpeg(like), **_fields(plan, side, times, like)
    )
    meter = ActivityMeter(quiet.image)
    kept: list[int] = []
    activity: list[float] = []
    energies: list[int] = []
    before: UInt8Array | None = None
    for piece in pieces:
        wanted = {
            pts: piece.first + i
            for i, pts in enumerate(piece.frames.pts[: len(piece.stamps)].tolist())
            if inside[piece.first + i]
        }
        for index, file, grey in jpeg_frames(piece.files.video, wanted, like, plan.quality):
            stream.append(
                int(times.time[index]),
                file,
                time_host=int(times.time_host[index]),
                flags=int(times.flags[index]),
            )
            kept.append(index)
            activity.append(meter.measure(grey))
            energies.append(difference_energy(grey if before is None else before, grey))
            before = grey
    stream.model.gaps = _gaps_between(kept, repeated, times.gaps) or None
    note_decoding(writer, name, like, plan.quality)
    rows = {index: row for row, index in enumerate(kept)}
    _set_reference(writer, stream, quiet, [rows[i] for i in quiet.frames if i in rows])
    store_activity(writer, name, meter, activity)
    add_salience(writer, name, energies)
    return len(kept)


def _gaps_between(
    kept: Sequence[int], repeated: NDArray[np.bool_], gaps: Sequence[Gap]
) -> list[Gap]:
    """Return the gaps of the frames that were kept, by their new indices."""
    reasons = {gap.after: gap.reason for gap in gaps}
    found = []
    for row, (one, other) in enumerate(pairwise(kept)):
        said = [reasons[at] for at in range(one, other) if at in reasons]
        copies = int(np.count_nonzero(repeated[one + 1 : other]))
        if said:
            found.append(Gap(after=row, reason=said[0]))
        elif copies:
            # They were written in the place of frames that were lost.
            reason = "the hub wrote the frame before it again"
            found.append(Gap(after=row, lost=copies, reason=reason))
        elif other != one + 1:
            reason = "it cannot be decoded"
            found.append(Gap(after=row, lost=other - one - 1, reason=reason))
    return found
