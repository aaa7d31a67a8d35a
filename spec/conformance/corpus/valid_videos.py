"""Valid cases: video that is grey, of touch, and whose time a clock or stamps correct."""

from collections.abc import Iterator

import numpy as np

from corpus import bases
from corpus.case import Case, case
from corpus.draft import Draft

__all__ = ["corrected", "stamped_by_the_host", "video_cases"]

COUNT = 8
# Of the file's pts, which are whole tenths of a second: 43 ppm are 4.3 us in each.
SHIFT_NS = 250_000_000 - 12_000_000
DRIFT_NS = 4_300


def grey() -> Draft:
    """Return the AVI file of a grey camera, in which every frame is a keyframe."""
    clip = (bases.SOURCES / "clip_grey.avi").read_bytes()
    draft = bases.video(clip)
    images = draft.metadata["streams"]["rgb"]["images"]
    images["channels"] = 1
    images["files"][0] |= {
        "name": "clip_grey.avi",
        "media_type": "video/x-msvideo",
        "codec": "mjpeg",
        "pixel_format": "gray",
        "time_base": "1/10",
    }
    draft.put("streams/rgb/pts", np.arange(COUNT, dtype=np.int64))
    draft.put("streams/rgb/keyframe", np.arange(COUNT, dtype=np.uint64))
    return draft


def tactile() -> Draft:
    """Return a tactile sensor whose video file was kept, with its reference."""
    draft = bases.video(kind="tactile")
    draft.metadata["streams"]["tactile"]["reference"] = {"method": "selected", "frames": [0]}
    reference = np.full((32, 32, 3), 120, dtype=np.uint8)
    draft.put("streams/tactile/reference", reference, names=("y", "x", "c"))
    return draft


def corrected() -> Draft:
    """Return a video whose time is that of its pts, corrected for offset, drift and latency."""
    draft = bases.video(start="2026-05-04T10:20:30Z")
    stream = draft.metadata["streams"]["rgb"]
    stream["images"]["files"][0]["start_ns"] = 5_000_000_000
    stream["clock"] |= {
        "t_ref_ns": 5_000_000_000,
        "offset_ns": 250_000_000,
        "drift_ppm": 43.0,
        "latency_ns": 12_000_000,
        "latency_sigma_ns": 1_000_000.0,
        "method": "claps",
    }
    own = np.arange(COUNT, dtype=np.int64)
    draft.put("streams/rgb/time", bases.times(COUNT) + SHIFT_NS + DRIFT_NS * own)
    return draft


def stamped_by_the_host() -> Draft:
    """Return a video whose frames were stamped as they arrived, whatever its pts say."""
    draft = bases.video()
    stream = draft.metadata["streams"]["rgb"]
    stream["clock"] = {
        "source": "hub_monotonic",
        "stamp_point": "user_rx",
        "raw_time": "time_host",
        "latency_ns": 20_000_000,
    }
    jitter = np.array([0, 900, -700, 300, 0, -1200, 400, 100], dtype=np.int64) * 1_000
    host = bases.times(COUNT) + 20_000_000 + jitter
    draft.put("streams/rgb/time", host - 20_000_000)
    draft.put("streams/rgb/time_host", host)
    draft.put("streams/rgb/sequence", np.arange(COUNT, dtype=np.uint64))
    return draft


def video_cases() -> Iterator[Case]:
    """Yield the cases."""
    yield case("images__video_grey", "The AVI file of a grey camera.", grey())
    yield case("tactile__video", "A tactile sensor's video file.", tactile())
    yield case("time__video_corrected", "Pts that a clock corrects.", corrected())
    yield case("time__video_stamped", "A video with stamps of its own.", stamped_by_the_host())
