"""Clips as they come from a camera's card: what their containers say, without decoding.

Frame times are the container's own. A clip's timecode and its creation time come from a clock that
somebody once set: they say roughly when, in an unknown time zone, and are used as no more.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, time
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from exumi_data.clips.gpmf import MAX_PAYLOAD_BYTES, GyroTrack, Payload, read_gyro
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import InputFile, VideoFile
from exumi_data.store.digest import sha256_file
from exumi_data.store.video import VideoDecoder, is_grey, probe_video

__all__ = [
    "MAX_DURATION_S",
    "Clip",
    "ClipFrames",
    "find_clips",
    "list_frames",
    "read_clip",
    "timecode_s",
]

MAX_DURATION_S = 12 * 3600.0
"""Of the longest clip that is looked at."""

_BEYOND_S = 1.0
_FIX = "Copy it again from the camera's card, or leave it out."
_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d{2,3})")
# GX010123.MP4: chapter 01 of recording 0123; GOPR0123.MP4 and GP010123.MP4 are the older form.
_NUMBERED = re.compile(r"(?:G[A-Z](\d\d)|GOPR)(\d{4})\.", re.IGNORECASE)
_MOST_PACKETS = 200_000
_SUFFIXES = (".mp4", ".mov")


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """A clip, as its container describes it.

    Attributes
    ----------
    path : pathlib.Path
    name : str
        Of the file, below the folder that was searched.
    duration_s : float
        From the first frame to the end of the last one, as the container says.
    timecode : str or None
        As it is written, such as ``10:31:07;12``.
    clock_s : float or None
        When it began by the camera's clock: seconds of the day, in some time zone.
    number : tuple of int or None
        The camera's own count of recordings, and the chapter, by the file's name.
    gyro : GyroTrack or None
        None where the clip has no gyroscope.
    """

    path: Path
    name: str
    duration_s: float
    timecode: str | None
    clock_s: float | None
    number: tuple[int, int] | None
    gyro: GyroTrack | None


@dataclass(frozen=True, slots=True, eq=False)
class ClipFrames:
    """The frames of a clip.

    Attributes
    ----------
    file : VideoFile
        What the episode says of it.
    pts : (N,) int64
        In units of the time base, ascending.
    keyframe : (N,) int64
        For each frame, the index of the frame to start decoding from.
    height, width : int
    channels : {1, 3}
    rate : Fraction or None
        Frames a second, as the container says.
    problem : str or None
        Why there are no more of them.
    """

    file: VideoFile
    pts: NDArray[np.int64]
    keyframe: NDArray[np.int64]
    height: int
    width: int
    channels: Literal[1, 3]
    rate: Fraction | None
    problem: str | None

    @property
    def span_ns(self) -> tuple[int, int]:
        """The first frame, and the end of the last one, on the clip's clock."""
        scale = Fraction(self.file.time_base) * 1_000_000_000
        period = float(np.median(np.diff(self.pts))) if len(self.pts) > 1 else 0.0
        return round(int(self.pts[0]) * scale), round((int(self.pts[-1]) + round(period)) * scale)

    @property
    def as_input(self) -> InputFile:
        """The file as an input of an episode."""
        return InputFile(name=self.file.name, sha256=self.file.sha256, bytes=self.file.bytes)


def timecode_s(text: str, rate: Fraction) -> float | None:
    """Return the time of day that a timecode shows.

    Drop-frame timecode (``;``) leaves out numbers, so that it keeps step with a clock at 30000/1001
    or 60000/1001 frames a second; any other is read as it stands.

    Parameters
    ----------
    text : str
        ``hh:mm:ss:ff`` or ``hh:mm:ss;ff``.
    rate : Fraction
        Frames a second.

    Returns
    -------
    float or None
        Seconds of the day; None where it is no timecode of this rate.
    """
    match = _TIMECODE.fullmatch(text.strip())
    nominal = round(rate)
    if match is None or nominal < 1:
        return None
    hours, minutes, seconds, frame = (int(match[group]) for group in (1, 2, 3, 5))
    if hours > 23 or minutes > 59 or seconds > 59 or frame >= nominal:
        return None
    whole = 3600 * hours + 60 * minutes + seconds
    if match[4] in ";." and nominal % 30 == 0 and rate != nominal:
        passed = 60 * hours + minutes
        dropped = (nominal // 15) * (passed - passed // 10)
        return float((whole * nominal + frame - dropped) / rate)
    return whole + frame / nominal


def find_clips(source: Path) -> list[Path]:
    """List the video files at a path: a file, or a folder and those below it.

    Parameters
    ----------
    source : pathlib.Path

    Raises
    ------
    UsageError
        There is none.
    """
    if source.is_file():
        return [source]
    found = [
        path
        for path in source.rglob("*")
        if path.suffix.lower() in _SUFFIXES and path.is_file() and not path.name.startswith(".")
    ]
    if not found:
        raise UsageError(
            "no clips (.mp4, .mov)" if source.is_dir() else "no such file or folder",
            where=source,
            fix="Name the folder into which the camera's card was copied.",
        )
    return sorted(found)


def read_clip(path: Path, name: str) -> Clip:
    """Read what a clip says of itself, and its gyroscope; its frames are passed over.

    Parameters
    ----------
    path : pathlib.Path
    name : str

    Raises
    ------
    SourceError
        It is not a readable video.
    """
    with VideoDecoder(str(path), path) as decoder:
        duration = decoder.duration_s
        if decoder.rate is None or duration is None:
            raise SourceError("does not say how long it is", where=path, fix=_FIX)
        if not 0 < duration < MAX_DURATION_S:
            raise SourceError(f"claims to be {duration:.3g} s long", where=path, fix=_FIX)
        tags = decoder.tags
        gyro = read_gyro(list(_payloads(decoder)))
        gyro = None if gyro is None else gyro.between(-_BEYOND_S, duration + _BEYOND_S)
        code = tags.get("timecode")
        return Clip(
            path=path,
            name=name,
            duration_s=duration,
            timecode=code,
            clock_s=_clock_s(code, tags.get("creation_time"), decoder.rate),
            number=_number(path.name),
            gyro=gyro,
        )


def _payloads(decoder: VideoDecoder) -> Iterator[Payload]:
    for packet in islice(decoder.data_packets(), _MOST_PACKETS):
        if packet.pts is None or packet.size > MAX_PAYLOAD_BYTES:
            continue
        data = bytes(packet)
        if data.startswith(b"DEVC"):
            base = Fraction(packet.time_base)
            yield Payload(float(packet.pts * base), float((packet.duration or 0) * base), data)


def _created(text: str | None) -> datetime | None:
    try:
        return None if text is None else datetime.fromisoformat(text)
    except ValueError:
        return None


def _clock_s(timecode: str | None, created: str | None, rate: Fraction) -> float | None:
    shown = None if timecode is None else timecode_s(timecode, rate)
    moment = _created(created)
    if shown is not None or moment is None:
        return shown
    return (moment - datetime.combine(moment.date(), time(), moment.tzinfo)).total_seconds()


def _number(name: str) -> tuple[int, int] | None:
    match = _NUMBERED.match(name)
    return None if match is None else (int(match[2]), int(match[1] or 0))


def list_frames(
    path: Path, name: str, *, check: bool = False, sha256: str | None = None
) -> ClipFrames:
    """List a clip's frames by its packets.

    Parameters
    ----------
    path : pathlib.Path
    name : str
        What the episode calls the file.
    check : bool, optional
        Decode them all, and list only those that can be; else none is decoded.
    sha256 : str, optional
        Of the file, where it is known already.

    Raises
    ------
    SourceError
        It is not a readable video, or holds no frame that could be decoded.
    """
    size = path.stat().st_size
    with VideoDecoder(str(path), path) as decoder:
        found: dict[int, bool] = {}
        problem = None
        for packet in decoder.packets():
            if packet.is_discard:
                continue
            if packet.pts is None or packet.pts in found or packet.is_corrupt:
                problem = "a frame is damaged or has no time of its own"
                continue
            found[packet.pts] = packet.is_keyframe
        problem = decoder.problem or problem
        pts = np.array(sorted(found), dtype=np.int64)
        is_key = np.array([found[one] for one in pts.tolist()], dtype=bool)
        if not is_key.any():
            raise SourceError(
                f"no frame can be decoded ({problem or 'there is no keyframe'})",
                where=path,
                fix=_FIX,
            )
        if check:
            pts, is_key, problem = _decoded(path, pts, is_key, problem)
        # What comes before the first keyframe builds on frames that are not in the file.
        first = int(is_key.argmax())
        pts, is_key = pts[first:], is_key[first:]
        if len(pts) < decoder.declared_frames:
            missing = f"{decoder.declared_frames} frames are declared, {len(pts)} are there"
            problem = f"{missing} ({problem})" if problem else missing
        return ClipFrames(
            file=_file(decoder, path, name, size, sha256),
            pts=pts,
            keyframe=np.maximum.accumulate(np.where(is_key, np.arange(len(pts)), 0)),
            height=decoder.height,
            width=decoder.width,
            channels=1 if is_grey(decoder.pixel_format) else 3,
            rate=decoder.rate,
            problem=problem,
        )


def _decoded(
    path: Path, pts: NDArray[np.int64], is_key: NDArray[np.bool_], problem: str | None
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str | None]:
    """Return the frames that can be decoded, and what is wrong with the others."""
    with VideoDecoder(str(path), path) as decoder:
        good = np.isin(pts, [int(frame.pts or 0) for frame in decoder.frames()])
        reason = decoder.problem or "they cannot be decoded"
    if good.all():
        return pts, is_key, problem
    if not (good & is_key).any():
        raise SourceError(f"no frame can be decoded ({reason})", where=path, fix=_FIX)
    said = f"{np.count_nonzero(~good)} frames are damaged: {reason}"
    return pts[good], is_key[good], f"{said}; {problem}" if problem else said


def _file(decoder: VideoDecoder, path: Path, name: str, size: int, sha256: str | None) -> VideoFile:
    base = decoder.time_base
    fields: dict[str, Any] = {
        "name": name,
        "media_type": probe_video(path.name),
        "codec": decoder.codec,
        "time_base": f"{base.numerator}/{base.denominator}",
        "sha256": sha256 or sha256_file(path),
        "bytes": size,
    }
    if decoder.pixel_format is not None:
        fields["pixel_format"] = decoder.pixel_format
    return VideoFile.model_validate(fields)
