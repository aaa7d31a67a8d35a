"""The GoPro's clip becomes the stream ``rgb``: the file verbatim, or its frames as JPEG.

Frame times are the container's, put on the hub's clock by an offset and, where it shows, a drift.
"""

from fractions import Fraction
from pathlib import Path
from typing import Any

from exumi_converters.exumi_session.decoded import as_jpeg, jpeg_frames, note_decoding
from exumi_converters.exumi_session.plan import EpisodePlan
from exumi_converters.frame_files import add_lossy
from exumi_converters.image_stream import times_of
from exumi_data.clips.clip import ClipFrames
from exumi_data.errors import SourceError
from exumi_data.model import Clock, LossyStep, QualityNote, Sensor, VideoImages
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import apply_clock

__all__ = ["CAMERA_STREAM", "add_clip"]

CAMERA_STREAM = "rgb"


def add_clip(writer: EpisodeWriter, plan: EpisodePlan, path: Path, frames: ClipFrames) -> int:
    """Write the camera's stream.

    Parameters
    ----------
    writer : EpisodeWriter
    plan : EpisodePlan
    path : pathlib.Path
        The clip.
    frames : ClipFrames

    Returns
    -------
    int
        Frames.

    Raises
    ------
    SourceError
        With ``decode``: not one frame can be decoded.
    """
    if frames.problem:
        writer.metadata.quality.append(
            QualityNote(code="truncated", message=frames.problem, stream=CAMERA_STREAM)
        )
    add_lossy(
        writer,
        LossyStep(
            step="video-encode",
            stream=CAMERA_STREAM,
            detail=f"the camera encoded its frames as {frames.file.codec} "
            f"({frames.file.pixel_format})",
        ),
    )
    if plan.decode:
        return _add_decoded(writer, plan, path, frames)
    stream = writer.add_stream(
        CAMERA_STREAM,
        kind="rgb",
        clock=_clock(plan),
        images=VideoImages(
            encoding="video",
            height=frames.height,
            width=frames.width,
            channels=frames.channels,
        ),
        **_fields(plan, frames),
    )
    stream.append_file(path, frames.file, pts=frames.pts, keyframe=frames.keyframe)
    return len(frames.pts)


def _clock(plan: EpisodePlan) -> Clock:
    clip = plan.clip
    return Clock(
        source="container",
        stamp_point="container_pts",
        t_ref_ns=clip.t_ref_ns,
        offset_ns=clip.t_ref_ns + clip.offset_ns - plan.start_ns,
        offset_sigma_ns=float(clip.sigma_ns),
        drift_ppm=clip.drift_ppm,
        drift_sigma_ppm=clip.drift_sigma_ppm,
        method=clip.method,
    )


def _fields(plan: EpisodePlan, frames: ClipFrames) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    if frames.rate is not None:
        fields["nominal_rate"] = f"{frames.rate.numerator}/{frames.rate.denominator}"
    if plan.clip.model is not None:
        fields["sensor"] = Sensor(
            model=plan.clip.model, manufacturer="GoPro", serial=plan.clip.camera
        )
    return fields


def _add_decoded(writer: EpisodeWriter, plan: EpisodePlan, path: Path, frames: ClipFrames) -> int:
    clock = _clock(plan)
    clock.raw_time = "time_device"
    device = times_of(frames.pts.tolist(), Fraction(frames.file.time_base))
    time = apply_clock(
        device,
        t_ref=clock.t_ref_ns,
        drift_ppm=clock.drift_ppm,
        offset_ns=clock.offset_ns,
        latency_ns=0,
    )
    stream = writer.add_stream(
        CAMERA_STREAM,
        kind="rgb",
        clock=clock,
        images=as_jpeg(frames),
        time_device_unit="ns",
        **_fields(plan, frames),
    )
    wanted = {pts: row for row, pts in enumerate(frames.pts.tolist())}
    written = 0
    for row, file, _ in jpeg_frames(path, wanted, frames, plan.quality):
        stream.append(int(time[row]), file, time_device=int(device[row]))
        written += 1
    if not written:
        raise SourceError("no frame can be decoded", where=path)
    if written < len(device):
        message = f"{len(device)} frames are listed, {written} can be decoded"
        writer.metadata.quality.append(
            QualityNote(code="truncated", message=message, stream=CAMERA_STREAM)
        )
    note_decoding(writer, CAMERA_STREAM, frames, plan.quality)
    return written
