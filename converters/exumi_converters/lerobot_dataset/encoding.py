"""Frames of a stream become an MP4 file, as LeRobot encodes its own."""

import os
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.lerobot_dataset.statistics import (
    ImageStatistics,
    Statistics,
    sampled_frames,
)
from exumi_data.episode import StreamView
from exumi_data.errors import UsageError

__all__ = ["check_encoder", "encode_frames", "video_info"]

_ENCODERS = {"av1": "libsvtav1", "h264": "libx264"}
_PIXELS = "yuv420p"
_MOST_CRF = {"av1": 63, "h264": 51}


def check_encoder(codec: str, crf: int) -> None:
    """Check that a codec can be encoded here.

    Raises
    ------
    UsageError
        This PyAV has no encoder for it, or the quality is none of its.
    """
    import av

    name = _ENCODERS[codec]
    if name not in av.codecs_available:
        raise UsageError(
            f"this PyAV ({av.__version__}) has no encoder {name}",
            fix="Choose the other codec: -o codec=h264 or -o codec=av1.",
        )
    if crf > _MOST_CRF[codec]:
        raise UsageError(f"Invalid crf ({crf}): {codec} knows 0 to {_MOST_CRF[codec]}")


def video_info(codec: str, fps: int | float) -> dict[str, Any]:
    """Return what ``info.json`` says of a video, beside its size.

    Parameters
    ----------
    codec : {"av1", "h264"}
    fps : int or float
    """
    return {
        "video.codec": codec,
        "video.pix_fmt": _PIXELS,
        "video.is_depth_map": False,
        "video.fps": fps,
        "video.channels": 3,
        "has_audio": False,
    }


def encode_frames(
    stream: StreamView, rows: np.ndarray, path: Path, fps: Fraction, told: dict[str, Any]
) -> Statistics:
    """Write frames as a video, one a tick; return their statistics.

    Memory stays at one frame; the same frames give the same bytes on any machine.

    Parameters
    ----------
    stream : StreamView
    rows : (M,) int64
        The frame of each tick.
    path : pathlib.Path
    fps : Fraction
    told : dict
        ``codec``, ``crf`` and ``keyframes``.

    Returns
    -------
    dict
    """
    import av

    # SVT-AV1 writes to the terminal by itself; 1 leaves it its errors.
    os.environ.setdefault("SVT_LOG", "1")
    _, height, width, channels = stream.frames.shape
    pixels = np.empty((1, height, width, channels), np.uint8)
    colour = np.empty((height, width, 3), np.uint8)
    looked_at = set(sampled_frames(len(rows)).tolist())
    statistics = ImageStatistics()
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        video = _add_video(container, fps, told)
        video.width, video.height, video.pix_fmt = width, height, _PIXELS
        previous = -1
        for tick, row in enumerate(rows.tolist()):
            if row != previous:
                stream.frames.read_into([row], pixels)
                colour[:] = pixels[0]  # grey becomes three equal channels
                previous = row
            if tick in looked_at:
                statistics.add(colour)
            container.mux(video.encode(av.VideoFrame.from_ndarray(colour, format="rgb24")))
        container.mux(video.encode())
    return statistics.finish()


def _add_video(container: Any, fps: Fraction, told: dict[str, Any]) -> Any:
    options = {"g": str(told["keyframes"]), "crf": str(told["crf"])}
    if told["codec"] == "av1":
        # LeRobot's preset. One thread: episodes are written side by side.
        options |= {"preset": "12", "svtav1-params": "lp=1"}
    video = container.add_stream(_ENCODERS[told["codec"]], rate=fps, options=options)
    video.codec_context.thread_count = 1
    return video
