"""Minimal valid episodes, one for each feature: what the cases are made from."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from corpus.draft import Draft, crc32c

__all__ = [
    "FRAME_NS",
    "SOURCES",
    "audio",
    "clocked",
    "derived",
    "empty",
    "encoded",
    "extension",
    "images_of",
    "jpegs",
    "mapped",
    "pixels",
    "poses",
    "put_encoded",
    "tactile",
    "taxels",
    "times",
    "video",
    "widths",
    "wrench",
]

SOURCES = Path(__file__).parents[1] / "sources"
FRAME_NS = 100_000_000
SIDE = 16
# x y z qx qy qz qw; the quaternions have norm 1 exactly
POSES = (
    (0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0),
    (0.25, 0.0, 0.5, 0.0, 0.0, 0.28, 0.96),
    (0.5, 0.125, 0.5, 0.0, 0.0, 0.6, 0.8),
    (0.5, 0.25, 0.5, 0.0, 0.0, 0.8, 0.6),
)


def times(count: int, step_ns: int = FRAME_NS) -> np.ndarray:
    """Return regular times, int64."""
    return np.arange(count, dtype=np.int64) * step_ns


def empty(**metadata: Any) -> Draft:
    """Return an episode without streams."""
    return Draft(**metadata)


def poses(**metadata: Any) -> Draft:
    """Return an episode with one pose stream of four samples."""
    draft = Draft(**metadata)
    draft.stream("pose", "pose", frames={"parent": "world", "child": "gripper"})
    draft.put("streams/pose/time", times(4))
    draft.put("streams/pose/data", np.array(POSES), names=("time", "component"))
    return draft


def widths(**metadata: Any) -> Draft:
    """Return an episode with a width stream, its encoder counts and their calibration."""
    value = {"m_per_count": 0.0001, "zero": 100}
    calibration = {"encoder": {"value": value, "unit": "m", "uncertainty": 0.0002}}
    draft = Draft(calibration=calibration, **metadata)
    raw = {"unit": "count", "transform": "encoder", "modulus": 4096}
    draft.stream("width", "width", raw=raw)
    counts = np.array([100, 200, 300, 500], dtype=np.uint16)
    draft.put("streams/width/time", times(4))
    width = np.array([0.0, 0.01, 0.02, 0.04], dtype=np.float32)
    draft.put("streams/width/data", width)
    draft.put("streams/width/raw", counts)
    return draft


def mapped(**metadata: Any) -> Draft:
    """Return an episode of a width whose calibration states the map, over the counts' end."""
    draft = widths(**metadata)
    points = {"raw": [3900, 4096, 4400], "data": [0.0, 0.0196, 0.08]}
    draft.metadata["calibration"]["encoder"]["value"] = {"raw_to_data": points}
    counts = np.array([3900, 3998, 0, 152], dtype=np.uint16)
    draft.put("streams/width/raw", counts)
    draft.put("streams/width/data", np.array([0.0, 0.0098, 0.0196, 0.0498], dtype=np.float32))
    return draft


def wrench(**metadata: Any) -> Draft:
    """Return an episode with the force of a grip."""
    draft = Draft(**metadata)
    draft.stream("force", "wrench", components=["f_grip"])
    draft.put("streams/force/time", times(4))
    forces = np.array([[0.0], [1.5], [3.0], [2.0]], dtype=np.float32)
    draft.put("streams/force/data", forces, names=("time", "component"))
    return draft


def taxels(**metadata: Any) -> Draft:
    """Return an episode with a grid of 3 by 2 cells, one of them dead."""
    draft = Draft(**metadata)
    draft.stream(
        "taxels",
        "taxels",
        grid=[3, 2],
        unit="adc",
        sign=-1,
        offset=3500.0,
        positions_m=[[0.001 * row, 0.001 * column] for row in range(3) for column in range(2)],
    )
    values = np.full((4, 3, 2), 3500, dtype=np.int16)
    values[2, 1, 1] = 3000
    draft.put("streams/taxels/time", times(4))
    draft.put("streams/taxels/data", values, names=("time", "row", "column"))
    valid = np.array([[True, True], [True, True], [True, False]])
    draft.put("streams/taxels/valid", valid, names=("row", "column"))
    return draft


def audio(**metadata: Any) -> Draft:
    """Return an episode with sound of two channels, in four blocks of which one is shorter."""
    draft = Draft(**metadata)
    draft.stream("sound", "audio", rate="8000", channels=2)
    edges = np.array([0, 80, 160, 200, 280], dtype=np.uint64)
    ramp = np.arange(280, dtype=np.int16)
    draft.put("streams/sound/time", np.array([0, 10, 20, 25]) * 1_000_000)
    draft.put("streams/sound/data", np.stack((ramp, -ramp), axis=1), names=("sample", "channel"))
    draft.put("streams/sound/offset", edges, names=("edge",))
    return draft


def jpegs(count: int = 4) -> list[bytes]:
    """Return JPEG files of 16 by 16 pixels, all different."""
    return [(SOURCES / f"frame_{index}.jpg").read_bytes() for index in range(count)]


def images_of(encoding: str, **fields: Any) -> dict[str, Any]:
    """Return the `images` of a stream of the corpus."""
    images = {"encoding": encoding, "height": SIDE, "width": SIDE, "channels": 3}
    return images | ({"media_type": "image/jpeg"} if encoding == "encoded" else {}) | fields


def put_encoded(draft: Draft, name: str, files: list[bytes], *, step_ns: int = FRAME_NS) -> None:
    """Add the arrays of frames stored as files."""
    base = f"streams/{name}"
    edges = np.cumsum([0, *(len(file) for file in files)]).astype(np.uint64)
    data = np.frombuffer(b"".join(files), dtype=np.uint8)
    draft.put(f"{base}/time", times(len(files), step_ns))
    draft.put(f"{base}/data", data, names=("byte",), zstd=False)
    draft.put(f"{base}/offset", edges, names=("edge",))
    draft.put(f"{base}/crc32c", np.array([crc32c(file) for file in files], dtype=np.uint32))


def encoded(**metadata: Any) -> Draft:
    """Return an episode with a camera whose JPEG files are kept."""
    draft = Draft(**metadata)
    draft.stream("rgb", "rgb", images=images_of("encoded"))
    put_encoded(draft, "rgb", jpegs())
    return draft


def tactile(**metadata: Any) -> Draft:
    """Return an episode with a tactile sensor and its reference."""
    draft = Draft(**metadata)
    draft.stream(
        "tactile",
        "tactile",
        images=images_of("encoded"),
        reference={"method": "captured"},
        mm_per_px=[0.05, 0.05],
        sensor={"model": "gelsight-mini", "side": "left"},
    )
    put_encoded(draft, "tactile", jpegs())
    reference = np.full((SIDE, SIDE, 3), 120, dtype=np.uint8)
    draft.put("streams/tactile/reference", reference, names=("y", "x", "c"))
    return draft


def derived(**metadata: Any) -> Draft:
    """Return an episode with activity and salient frames."""
    draft = tactile(**metadata)
    draft.derive(
        "tactile/activity",
        np.array([0.0, 0.25, 0.5, 0.125], dtype=np.float32),
        names=("time",),
        algorithm="exumi-activity/1",
        parameters={"threshold": 5.828571428571429, "size": 224, "active_above": 0.001},
        inputs=["streams/tactile/data", "streams/tactile/reference"],
    )
    draft.derive(
        "tactile/salient",
        np.array([1, 2], dtype=np.int64),
        names=("index",),
        algorithm="octopi-salience/1",
        parameters={"k": 2},
        inputs=["streams/tactile/data"],
    )
    return draft


def pixels(**metadata: Any) -> Draft:
    """Return an episode with grey frames stored as pixels, one frame a chunk."""
    draft = Draft(**metadata)
    images = images_of("array", height=4, width=4, channels=1)
    draft.stream("rgb", "rgb", images=images)
    frames = (np.arange(64, dtype=np.uint8) * 3).reshape(4, 4, 4, 1)
    draft.put("streams/rgb/time", times(4))
    names = ("time", "y", "x", "c")
    draft.put("streams/rgb/data", frames, names=names, chunk_rows=1, zstd=False)
    return draft


def video(clip: bytes | None = None, *, kind: str = "rgb", **metadata: Any) -> Draft:
    """Return an episode with a video file kept as it was: 8 frames, keyframes 0 and 4.

    The stream has the name of its kind.
    """
    draft = Draft(**metadata)
    clip = clip or (SOURCES / "clip.mp4").read_bytes()
    file = {
        "name": "clip.mp4",
        "media_type": "video/mp4",
        "codec": "mpeg4",
        "time_base": "1/10240",
        "sha256": hashlib.sha256(clip).hexdigest(),
        "bytes": len(clip),
    }
    draft.stream(
        kind,
        kind,
        images=images_of("video", height=32, width=32, files=[file]),
        nominal_rate="10",
        clock={"source": "container", "stamp_point": "container_pts"},
    )
    base = f"streams/{kind}"
    draft.put(f"{base}/time", times(8))
    data = np.frombuffer(clip, dtype=np.uint8)
    draft.put(f"{base}/data", data, names=("byte",), zstd=False)
    draft.put(f"{base}/offset", np.array([0, len(clip)], dtype=np.uint64), names=("edge",))
    draft.put(f"{base}/file", np.zeros(8, dtype=np.uint32))
    draft.put(f"{base}/pts", np.arange(8, dtype=np.int64) * 1024)
    draft.put(f"{base}/keyframe", np.array([0, 0, 0, 0, 4, 4, 4, 4], dtype=np.uint64))
    return draft


def clocked(**metadata: Any) -> Draft:
    """Return an episode whose time was corrected for offset, drift and latency.

    Sample 2 came before its predecessor and was nudged; two samples are missing before sample 3.
    """
    draft = poses(start="2026-05-04T10:20:30.123456789Z", **metadata)
    stream = draft.metadata["streams"]["pose"]
    stream["clock"] = {
        "source": "hub_monotonic",
        "stamp_point": "kernel_rx",
        "raw_time": "time_host",
        "t_ref_ns": 5_000_000_000,
        "offset_ns": 1_000,
        "offset_sigma_ns": 50.0,
        "drift_ppm": 20.0,
        "latency_ns": 12_000_000,
        "latency_sigma_ns": 300_000.0,
        "method": "sweep",
    }
    stream["gaps"] = [{"after": 2, "lost": 2, "reason": "kernel"}]
    stream["lost"] = {"kernel": 2}
    stream["time_device_unit"] = "us"
    raw = np.array([5_000_000_000, 5_100_000_000, 5_100_000_000, 5_400_000_000], dtype=np.int64)
    time = np.array([-11_999_000, 88_003_000, 88_003_001, 388_009_000], dtype=np.int64)
    draft.put("streams/pose/time", time)
    draft.put("streams/pose/time_host", raw)
    draft.put("streams/pose/time_device", np.array([70, 100_070, 100_070, 400_081]))
    draft.put("streams/pose/sequence", np.array([10, 12, 11, 15], dtype=np.uint64))
    draft.put("streams/pose/flags", np.array([0, 4, 3, 4], dtype=np.uint32))
    return draft


def extension(**metadata: Any) -> Draft:
    """Return an episode with a third party's kind, and keys of its own."""
    draft = Draft(**metadata)
    draft.metadata["acme:rig"] = {"schema_url": "https://acme.example/rig.json", "table": 3}
    draft.stream(
        "current",
        "acme:motor-current",
        extension_version="2",
        schema_url="https://acme.example/motor-current.json",
        **{"acme:motor": "left"},
    )
    draft.put("streams/current/time", times(4))
    draft.put("streams/current/data", np.array([1, 2, 3, 4], dtype=np.int16))
    return draft
