"""One clip with its part of the session becomes an episode."""

import hashlib
import json
import math
import uuid
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from exumi_data._version import __version__
from exumi_data.clips.clip import Clip, ClipFrames
from exumi_data.editing.cutting import Stretch, cut_annotations, cut_stream
from exumi_data.episode import Episode, StreamView
from exumi_data.model import (
    CONVENTION_UUID,
    Clock,
    EpisodeMetadata,
    QualityNote,
    Sensor,
    Source,
    VideoImages,
)
from exumi_data.standard import sensors
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.synchronisation.matching import Match
from exumi_data.synchronisation.placing import METHOD, Placement

__all__ = [
    "DOUBTFUL",
    "TOOL",
    "Attachment",
    "describe",
    "episode_id",
    "notes_on",
    "offset_sigma_s",
    "write_episode",
]

TOOL = "exumi attach"
DOUBTFUL = "doubtful-place"
"""Code of the note on a clip whose place is not quite certain."""
_CONVERTER = "attach/1"
_MARGIN_SHORT_NS = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """What is to become one episode.

    Attributes
    ----------
    session : Episode
    session_digest : str
    pose : str
        The stream by which the clip was placed.
    stream : str
        What the clip's stream is called.
    margin_ns : int
        How much of the session is kept before and after the clip.
    without : tuple of str
        Streams of the session that are left out.
    clip : Clip
    frames : ClipFrames
    match : Match
    """

    session: Episode
    session_digest: str
    pose: str
    stream: str
    margin_ns: int
    without: tuple[str, ...]
    clip: Clip
    frames: ClipFrames
    match: Match

    @property
    def placement(self) -> Placement:
        """Where the clip belongs."""
        assert self.match.placement is not None  # noqa: S101  # only placed clips are attached
        return self.match.placement

    @property
    def stretch(self) -> Stretch:
        """The part of the session that the episode takes."""
        start, stop = (self.placement.to_session(at) for at in self.frames.span_ns)
        first = start - self.margin_ns
        return Stretch(first, stop + self.margin_ns, first)


def offset_sigma_s(pose: StreamView, clip: Clip, placement: Placement) -> float:
    """Return the standard deviation of a clip's offset, all that is known of included; seconds.

    Parameters
    ----------
    pose : StreamView
        The poses that it was placed by: what their latency is off by is part of it.
    clip : Clip
    placement : Placement
    """
    latency = (pose.metadata.clock.latency_sigma_ns or 0.0) * 1e-9
    gyro = clip.gyro.sigma_s if clip.gyro else 0.0
    return math.hypot(placement.sigma_s, gyro, placement.camera_sigma_s, latency)


def episode_id(session: Episode, clip_sha256: str) -> str:
    """Return the id of a clip's episode: the same for the same session and clip.

    Of a recorded session it is a UUIDv7 with the session's own moment, so that it lies beside it;
    its other bits are a digest. Of a converted one it is the UUIDv5 of the standard.

    Parameters
    ----------
    session : Episode
    clip_sha256 : str
    """
    if session.metadata.source.type == "converted":
        name = f"{_CONVERTER}\n{clip_sha256}\n{session.id}"
        return str(uuid.uuid5(uuid.UUID(CONVENTION_UUID), name))
    known = uuid.UUID(session.id)
    moment = known.int >> 80 if known.version == 7 else 0
    digest = hashlib.sha256(f"{_CONVERTER}\n{session.id}\n{clip_sha256}".encode()).digest()
    bits = int.from_bytes(digest[:10], "big")
    value = (moment << 80) | (0x7 << 76) | ((bits >> 68) << 64 & (0xFFF << 64))
    value |= (0b10 << 62) | (bits & ((1 << 62) - 1))
    return str(uuid.UUID(int=value))


def describe(attachment: Attachment) -> EpisodeMetadata:
    """Return an episode's metadata, but for its streams.

    Parameters
    ----------
    attachment : Attachment
    """
    session, stretch = attachment.session, attachment.stretch
    placement = attachment.placement
    parent = session.metadata
    metadata = parent.model_copy(deep=True)
    metadata.id = episode_id(session, attachment.frames.file.sha256)
    metadata.revision, metadata.streams = 1, {}
    metadata.start = later(parent.start, stretch.origin_ns)
    metadata.annotations = cut_annotations(parent.annotations, stretch)
    settings: dict[str, Any] = {
        "method": placement.method,
        "pose": attachment.pose,
        "stream": attachment.stream,
        "margin_ns": attachment.margin_ns,
        "without": list(attachment.without),
        "session_offset_ns": placement.offset_ns,
        "session_t_ref_ns": placement.t_ref_ns,
        "session_drift_ppm": placement.drift_ppm,
        "correlation": round(placement.correlation, 5),
        "frames": len(attachment.frames.pts),
        "session_tool": f"{parent.source.tool} {parent.source.tool_version}",
    }
    converted = parent.source.type == "converted"
    metadata.source = Source(
        type=parent.source.type,
        tool=TOOL,
        tool_version=__version__,
        converter=_CONVERTER if converted else None,
        key=session.id if converted else attachment.clip.name,
        inputs=[attachment.frames.as_input],
        settings=settings,
        settings_sha256=_digest(settings),
        lossy=[s for s in parent.source.lossy or [] if s.stream not in attachment.without] or None,
        parent_id=session.id,
        parent_digest=attachment.session_digest,
    )
    metadata.quality = [note for note in metadata.quality if note.stream not in attachment.without]
    metadata.quality += notes_on(attachment)
    return metadata


def _digest(settings: dict[str, Any]) -> str:
    text = json.dumps(settings, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def notes_on(attachment: Attachment) -> list[QualityNote]:
    """Return what a user of the episode should know of its clip.

    Parameters
    ----------
    attachment : Attachment
    """
    stream, clip = attachment.stream, attachment.clip
    notes = [
        QualityNote(code=DOUBTFUL, message=f"{clip.name}: {doubt}", stream=stream)
        for doubt in attachment.match.doubts
    ]
    if attachment.frames.problem:
        message = f"{clip.name}: {attachment.frames.problem}"
        notes.append(QualityNote(code="truncated", message=message, stream=stream))
    if clip.gyro is not None and clip.gyro.problem:
        message = f"{clip.name}: {clip.gyro.problem}"
        notes.append(QualityNote(code="telemetry", message=message, stream=stream, severity="info"))
    pose = attachment.session[attachment.pose].time
    start, stop = (attachment.placement.to_session(at) for at in attachment.frames.span_ns)
    outside = max(int(pose[0]) - start, stop - int(pose[-1]))
    if outside > _MARGIN_SHORT_NS:
        message = f"{clip.name}: {outside * 1e-9:.1f} s of it lie outside of the session"
        notes.append(QualityNote(code="session-short", message=message, stream=stream))
    return notes


def write_episode(
    attachment: Attachment, metadata: EpisodeMetadata, path: Path, *, durable: bool = True
) -> int:
    """Write the episode: it appears whole, or not at all.

    Parameters
    ----------
    attachment : Attachment
    metadata : EpisodeMetadata
        As `describe` gives them.
    path : pathlib.Path
        The episode's final name; one that is there is replaced.
    durable : bool, optional
        Make it survive a power loss before it appears.

    Returns
    -------
    int
        Frames of the clip.
    """
    session, stretch = attachment.session, attachment.stretch
    with EpisodeWriter(path, metadata, overwrite=True, durable=durable) as writer:
        _write_clip(attachment, writer)
        for name in session:
            if name not in attachment.without:
                cut_stream(session, name, writer, stretch)
        writer.copy_group(session, "calibration")
        writer.copy_group(session, "annotations")
    return len(attachment.frames.pts)


def _write_clip(attachment: Attachment, writer: EpisodeWriter) -> None:
    frames, placement = attachment.frames, attachment.placement
    rate = frames.rate
    pose = attachment.session[attachment.pose]
    stream = writer.add_stream(
        attachment.stream,
        kind="rgb",
        clock=Clock(
            source="container",
            stamp_point="container_pts",
            t_ref_ns=placement.t_ref_ns,
            offset_ns=placement.t_ref_ns + placement.offset_ns - attachment.stretch.origin_ns,
            offset_sigma_ns=round(1e9 * offset_sigma_s(pose, attachment.clip, placement)),
            drift_ppm=placement.drift_ppm,
            drift_sigma_ppm=placement.drift_sigma_ppm,
            method=_method(attachment),
        ),
        images=VideoImages(
            encoding="video",
            height=frames.height,
            width=frames.width,
            channels=frames.channels,
        ),
        nominal_rate=None if rate is None else f"{rate.numerator}/{rate.denominator}",
        sensor=_sensor(attachment.clip),
    )
    stream.append_file(attachment.clip.path, frames.file, pts=frames.pts, keyframe=frames.keyframe)


def _method(attachment: Attachment) -> str:
    placement, pose = attachment.placement, attachment.pose
    compared = "where a marker is in its frames"
    taken = "when its frames saw it is known"
    if placement.method == METHOD:
        compared = "angular speed of the camera's gyroscope"
        taken = "the camera's pictures are taken to be in step with its gyroscope"
    return (
        f"{placement.method}: {compared} against {pose!r}, correlation "
        f"{placement.correlation:.3f}; by itself {placement.sigma_s * 1e3:.2f} ms; {taken} to "
        f"{placement.camera_sigma_s * 1e3:.2g} ms"
    )


def _sensor(clip: Clip) -> Sensor | None:
    """Return the camera's model, where it says one that is registered."""
    said = "".join(filter(str.isalnum, clip.gyro.device.casefold() if clip.gyro else ""))
    for name, model in sensors().items():
        if model.maker == "GoPro" and name.removeprefix("gopro-") in said:
            return Sensor(model=name, manufacturer=model.maker)
    return None


def later(start: str | None, ns: int) -> str | None:
    """Return a timestamp that is later by so many nanoseconds.

    Parameters
    ----------
    start : str or None
        A timestamp of the format.
    ns : int
    """
    if start is None:
        return None
    text, _, rest = start.removesuffix("Z").partition(".")
    leap = text.endswith(":60")
    moment = datetime.fromisoformat(text[:-2] + "59" if leap else text)
    seconds, fraction = divmod(int(rest.ljust(9, "0") or "0") + ns, 1_000_000_000)
    moment += timedelta(seconds=seconds + leap)
    return f"{moment.isoformat()}.{fraction:09d}Z"
