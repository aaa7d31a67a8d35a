"""Valid cases: features together, and what is allowed at the edges."""

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import Case, as_zip, case, packed
from corpus.datasets import EGG, RICE, dataset, packed_episodes, place, split_by_part
from corpus.draft import Draft
from corpus.valid import bimanual

__all__ = ["combined_cases", "mapped"]

_CATALOG = "catalog.parquet"
_SPLIT = "splits/default.json"


def add_taxels(draft: Draft, name: str, **fields: Any) -> None:
    """Add a stream of a grid of 2 by 2 cells, floating-point numbers."""
    draft.stream(name, "taxels", grid=[2, 2], unit="N", **fields)
    draft.put(f"streams/{name}/time", bases.times(8, 10_000_000))
    values = np.linspace(0.0, 0.7, 32, dtype=np.float32).reshape(8, 2, 2)
    draft.put(f"streams/{name}/data", values, names=("time", "row", "column"))


def add_wrench(draft: Draft, name: str) -> None:
    """Add a stream of six components, with the device's own counts beside them."""
    components = ["fx", "fy", "fz", "tx", "ty", "tz"]
    raw = {"unit": "adc", "transform": "strain"}
    draft.stream(name, "wrench", components=components, reference_frame="wrist", raw=raw)
    counts = np.arange(48, dtype=np.int16).reshape(8, 6)
    draft.put(f"streams/{name}/time", bases.times(8, 10_000_000))
    names = ("time", "component")
    draft.put(f"streams/{name}/data", (counts / 16).astype(np.float32), names=names)
    draft.put(f"streams/{name}/raw", counts, names=names)


def all_sensors() -> Draft:
    """Return an episode of two hands with images, taxels and wrenches, at five rates."""
    draft = bimanual()
    for side in ("left", "right"):
        add_taxels(draft, f"taxels_{side}", sensor={"model": "acme-pad", "side": side})
        add_wrench(draft, f"wrist_{side}")
    draft.metadata.setdefault("calibration", {})["strain"] = {
        "value": {"n_per_count": 0.0625},
        "method": "dead weights",
    }
    return draft


def all_encodings() -> Draft:
    """Return an episode with a stream in each encoding of images, one of them grey JPEG files."""
    draft = bases.video()
    draft.stream("wrist", "rgb", images=bases.images_of("encoded"))
    bases.put_encoded(draft, "wrist", bases.jpegs())
    draft.stream("depth", "rgb", images=bases.images_of("encoded", channels=1))
    bases.put_encoded(draft, "depth", [(bases.SOURCES / "frame_grey.jpg").read_bytes()])
    draft.stream("tactile", "tactile", images=bases.images_of("array", height=4, width=4))
    frames = (np.arange(144, dtype=np.uint8) + 50).reshape(3, 4, 4, 3)
    draft.put("streams/tactile/time", bases.times(3))
    names = ("time", "y", "x", "c")
    draft.put("streams/tactile/data", frames, names=names, chunk_rows=1)
    draft.metadata["streams"]["tactile"]["reference"] = {
        "method": "estimated",
        "contact_free": None,
        "algorithm": "median/1",
    }
    draft.put("streams/tactile/reference", frames[0], names=("y", "x", "c"))
    return draft


def two_files() -> Draft:
    """Return an episode whose camera began a second file."""
    draft = bases.video()
    stream = draft.metadata["streams"]["rgb"]
    (first,) = stream["images"]["files"]
    second = {**first, "name": "clip2.mp4", "start_ns": 1_000_000_000}
    stream["images"]["files"] = [first, second]
    clip = (bases.SOURCES / "clip.mp4").read_bytes()
    edges = np.array([0, len(clip), 2 * len(clip)], dtype=np.uint64)
    own = np.arange(8, dtype=np.int64)
    keyframe = np.array([0, 0, 0, 0, 4, 4, 4, 4], dtype=np.uint64)
    base = "streams/rgb"
    times = np.concatenate([bases.times(8), bases.times(8) + 1_000_000_000])
    draft.put(f"{base}/time", times)
    data = np.frombuffer(2 * clip, dtype=np.uint8)
    draft.put(f"{base}/data", data, names=("byte",), zstd=False)
    draft.put(f"{base}/offset", edges, names=("edge",))
    draft.put(f"{base}/file", np.repeat(np.arange(2, dtype=np.uint32), 8))
    draft.put(f"{base}/pts", np.tile(own * 1024, 2))
    draft.put(f"{base}/keyframe", np.concatenate([keyframe, keyframe + np.uint64(8)]))
    draft.metadata["source"]["key"] = hashlib.sha256(clip).hexdigest()[:8]
    return draft


def vendor_keys() -> Draft:
    """Return an episode in which third parties' keys stand in objects of all sorts."""
    draft = bases.derived(
        start="2026-05-04T10:20:30Z",
        device={"name": "hand", "acme:batch": 7},
        embodiment={"name": "gripper", "acme:paint": "grey"},
    )
    metadata = draft.metadata
    url = "https://acme.example/rig/1.json"
    metadata["acme:rig"] = {"schema_url": url, "table": 3, "lamps": [1, 2.5, None, True]}
    metadata["other-lab:note"] = "kept"
    metadata["task"]["acme:difficulty"] = 0.5
    metadata["source"]["acme:node"] = "a"
    metadata["calibration"] = {
        "tcp": {
            "value": [0, 0, 0.1, 0, 0, 0, 1],
            "unit": "acme:cubit",
            "method": "measured",
            "acme:by": "laser",
        }
    }
    metadata["annotations"] = {
        "object_id": "egg",
        "acme:weight": 60,
        "segments": [{"name": "touch", "start_ns": 0, "end_ns": 1, "acme:sure": False}],
    }
    stream = metadata["streams"]["tactile"]
    stream["acme:light"] = 0.8
    for part in ("clock", "images", "reference", "sensor"):
        stream[part]["acme:part"] = part
    group = draft.nodes["derived"]["attributes"]["exumi"]
    group["acme:farm"] = "b"
    group["items"]["tactile/activity"]["acme:seconds"] = 1.25
    return draft


def recorded() -> Draft:
    """Return an episode as a recorder writes it: a demonstration that begins before its epoch."""
    draft = bases.encoded(
        id="01903a50-1b2c-7d3e-8f40-5a6b7c8d9e0f",
        revision=2,
        start="2024-06-21T09:15:00.000000001Z",
        task={"name": "crack an egg", "instruction": "Crack the egg without losing the yolk."},
        regime="demonstration",
        success=False,
        operator="p-07",
        site="kitchen",
        device={"name": "hand-held gripper", "serial": "0001", "hub": "raspberry pi 5"},
        embodiment={"name": "parallel gripper", "gripper": "parallel", "max_width_m": 0.08},
        licence="CC-BY-4.0 OR LicenseRef-lab",
        source={"type": "recorded", "tool": "corpus", "tool_version": "1"},
        annotations={"object_id": "egg", "trial": 4, "labels": []},
    )
    stream = draft.metadata["streams"]["rgb"]
    stream["clock"] = {"source": "hub_monotonic", "stamp_point": "user_rx", "raw_time": "time_host"}
    stream["nominal_rate"] = "10"
    stream["sensor"] = {"model": "uvc-camera", "manufacturer": "acme", "serial": "17"}
    stream["gaps"] = [{"after": -1, "reason": "warm-up"}, {"after": 1, "lost": 1, "reason": "usb"}]
    stream["lost"] = {"kernel": 1, "crc": 0}
    # Sample 2 is late by the frame that was lost, 3 came again on time.
    times = np.array([-150_000_000, -50_000_000, 150_000_000, 250_000_000], dtype=np.int64)
    draft.put("streams/rgb/time", times)
    draft.put("streams/rgb/time_host", times)
    draft.put("streams/rgb/sequence", np.array([4, 5, 7, 8], dtype=np.uint64))
    draft.put("streams/rgb/flags", np.array([0, 0, 4, 0], dtype=np.uint32))
    return draft


def newer_documents() -> Draft:
    """Return an episode of 1.0 whose derived arrays are of a newer minor version."""
    draft = bases.derived()
    draft.nodes["derived"]["attributes"]["exumi"]["version"] = "1.12"
    return draft


def padded(file: bytes, length: int) -> bytes:
    """Return a JPEG file with a segment of zeros for an application."""
    return file[:2] + b"\xff\xef" + (length + 2).to_bytes(2, "big") + bytes(length) + file[2:]


def several_shards() -> Draft:
    """Return JPEG files that lie across inner chunks and shards, and frames in shards of two."""
    draft = bases.encoded()
    files = [padded(file, 20_000) for file in bases.jpegs(4)]
    bases.put_encoded(draft, "rgb", files)
    data = np.frombuffer(b"".join(files), dtype=np.uint8)
    rows = 65536
    draft.put(
        "streams/rgb/data",
        data,
        names=("byte",),
        zstd=False,
        chunk_rows=rows,
        chunks_per_shard=1,
    )
    draft.stream("grey", "rgb", images=bases.images_of("array", height=2, width=2, channels=1))
    frames = np.arange(20, dtype=np.uint8).reshape(5, 2, 2, 1)
    draft.put("streams/grey/time", bases.times(5))
    names = ("time", "y", "x", "c")
    draft.put("streams/grey/data", frames, names=names, chunk_rows=1, chunks_per_shard=2)
    return draft


def commented() -> Draft:
    """Return JPEG files that all carry the comment of their encoder, of no licence."""
    draft = bases.encoded(licence="NONE")
    comment = b"Lavc62.0.100"
    segment = b"\xff\xfe" + (len(comment) + 2).to_bytes(2, "big") + comment
    bases.put_encoded(draft, "rgb", [file[:2] + segment + file[2:] for file in bases.jpegs()])
    draft.metadata["streams"]["rgb"]["images"]["jpeg_comment"] = comment.decode()
    return draft


def known_fingers() -> Draft:
    """Return two fingers whose rig knows how each of them looks without contact."""
    draft = Draft(calibration={})
    gels = np.random.default_rng(3).integers(60, 190, (2, 32, 32, 3), dtype=np.uint8)
    draft.group("calibration")
    draft.group("calibration/tactile_reference")
    for side, gel in zip(("left", "right"), gels, strict=True):
        name, path = f"tactile_{side}", f"calibration/tactile_reference/tactile_{side}"
        images = bases.images_of("array", height=32, width=32)
        draft.stream(name, "tactile", images=images, reference={"method": "captured"})
        frames = np.repeat(gel[None], 16, axis=0)
        frames[:, :2, :2] += np.arange(16, dtype=np.uint8)[:, None, None, None]
        draft.put(f"streams/{name}/time", bases.times(16))
        axes = ("y", "x", "c")
        draft.put(f"streams/{name}/data", frames, names=("time", *axes), chunk_rows=1)
        draft.put(f"streams/{name}/reference", gel, names=axes)
        draft.put(path, gel, names=axes)
        item = {"value": None, "array": path, "method": "captured without contact"}
        draft.metadata["calibration"][f"tactile_reference/{name}"] = item
    return draft


def mapped() -> Draft:
    """Return a finger with the map that rectifies it, and two cameras whose lenses are known."""
    draft = bases.tactile(calibration={})
    items = draft.metadata["calibration"]
    images = draft.metadata["streams"]["tactile"]["images"]
    height, width = images["height"], images["width"]
    index = np.stack(np.mgrid[:height, :width], axis=-1).astype(np.uint16)
    index[:, :, 1] = index[:, ::-1, 1]  # mirrored
    path = "calibration/rectification/tactile"
    draft.group("calibration")
    draft.group("calibration/rectification")
    draft.put(path, index, names=("y", "x", "index"))
    value = {"centre_px": [7.5, 8.0], "crop_px": [8, 12], "mm_per_px": [0.05, 0.06]}
    how = {"unit": "px", "method": "grid of points, cubic"}
    items["rectification/tactile"] = {"value": value, "array": path, "residual": 0.4, **how}
    size = {"width": 16, "height": 16}
    for name, lens in (
        ("wide", {"model": "fisheye", "distortion": [-0.02, -0.01, 0.001, -0.0001]}),
        ("narrow", {"model": "pinhole", "skew": 0.5}),
    ):
        draft.stream(name, "rgb", images=bases.images_of("encoded"))
        bases.put_encoded(draft, name, bases.jpegs())
        middle = {"fx": 8.0, "fy": 8.25, "cx": 7.5, "cy": 7}
        items[f"intrinsics/{name}"] = {"value": {**lens, **size, **middle}, **how}
    return draft


def stamped() -> Draft:
    """Return poses stamped at the points that no other case has, of an angular gripper."""
    draft = Draft(embodiment={"name": "claw", "gripper": "angular"})
    for point in ("device", "unknown", "buffer_soe", "bracket_mid"):
        name = f"pose_{point}"
        draft.stream(name, "pose", frames={"parent": "world", "child": "gripper"})
        draft.metadata["streams"][name]["clock"]["stamp_point"] = point
        draft.put(f"streams/{name}/time", bases.times(4))
        draft.put(f"streams/{name}/data", np.array(bases.POSES), names=("time", "component"))
    return draft


def grey_reference() -> Draft:
    """Return colour frames with a grey reference, and a vendor's derived array."""
    draft = bases.tactile()
    reference = np.full((16, 16, 1), 120, dtype=np.uint8)
    draft.put("streams/tactile/reference", reference, names=("y", "x", "c"))
    slip = np.array([0, 0, 1, 0], dtype=np.uint8)
    draft.derive("tactile/other_lab__slip", slip, names=("time",), algorithm="slip/2")
    return draft


def _dataset_cases() -> Iterator[Case]:
    empty = (bases.SOURCES / "catalog_empty.parquet").read_bytes()
    yield dataset(
        "dataset__empty", "No episode yet.", drop=("episodes/",), replace={_CATALOG: empty}
    )
    catalog = (bases.SOURCES / "catalog_packed.parquet").read_bytes()
    yield dataset(
        "dataset__packed",
        "Two packed episodes.",
        drop=(f"{place(EGG)}/", f"{place(RICE)}/"),
        add=packed_episodes(),
        replace={_CATALOG: catalog},
    )
    by_object = split_by_part(level="object", method="by hand", seed=3)
    by_episode = split_by_part(name="all", level="episode", lists={"all": [RICE, EGG], "none": []})
    newer = {"version": "1.1", "authors": ["A. Person"], "citation": "Person 2026"}
    yield dataset(
        "dataset__two_splits",
        "Splits of two levels, one with an empty list, and a newer minor version.",
        add={_SPLIT: by_object, "splits/all.json": by_episode, "README.md": b"# corpus\n"},
        splits=["all", "default"],
        description="Of everything a little.",
        made_by={"tool": "corpus", "tool_version": "1", "settings": {"seed": 1}},
        **{"acme:grant": "42"},
        **newer,
    )


def combined_cases() -> Iterator[Case]:
    """Yield the cases."""
    yield case("streams__all_sensors", "Two hands, images, taxels, wrenches.", all_sensors())
    yield case("images__all_encodings", "Each encoding, and grey JPEG files.", all_encodings())
    yield case("images__two_videos", "A camera that began a second file.", two_files())
    yield case("images__several_shards", "Frames across chunks and shards.", several_shards())
    yield case("source__recorded", "A demonstration with gaps, flags, counters.", recorded())
    yield case("extension__keys_everywhere", "Third parties' keys in all objects.", vendor_keys())
    yield case("version__newer_derived", "Derived arrays of version 1.12.", newer_documents())
    yield packed("packed__video", "A packed episode with video.", as_zip(bases.video().files()))
    yield packed(
        "packed__empty", "A packed episode without streams.", as_zip(bases.empty().files())
    )
    yield case("images__comment", "JPEG files with a comment, of no licence.", commented())
    yield case("calibration__fingers", "Two fingers and how they look.", known_fingers())
    yield case("calibration__images", "A rectification map, and lenses.", mapped())
    yield case("clock__stamp_points", "Stamp points, and an angular gripper.", stamped())
    yield case("tactile__grey_reference", "A grey reference, a vendor's array.", grey_reference())
    yield from _dataset_cases()
