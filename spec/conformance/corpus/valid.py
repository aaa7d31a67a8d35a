"""Valid cases: one for each feature, and some together."""

from collections.abc import Iterator

import numpy as np

from corpus import bases
from corpus.case import Case, as_zip, case, packed
from corpus.datasets import dataset, split_by_part
from corpus.draft import Draft
from corpus.manifests import valid_manifest
from corpus.quality_sync import grasp, tap
from corpus.quality_timing import counted, events

__all__ = ["bimanual", "valid_cases"]


def bimanual() -> Draft:
    """Return an episode of two grippers, each stream at a rate of its own."""
    draft = bases.tactile()
    for side in ("left", "right"):
        draft.stream(f"pose_{side}", "pose", frames={"parent": "world", "child": f"{side}_tcp"})
        draft.put(f"streams/pose_{side}/time", bases.times(4, 11_111_111))
        names = ("time", "component")
        draft.put(f"streams/pose_{side}/data", np.array(bases.POSES), names=names)
        draft.stream(f"width_{side}", "width")
        draft.put(f"streams/width_{side}/time", bases.times(9, 2_000_000))
        draft.put(f"streams/width_{side}/data", np.full(9, 0.05, dtype=np.float32))
    return draft


def converted() -> Draft:
    """Return an episode that was converted, with labels, a lossy step and unknown start."""
    draft = bases.tactile(
        id="5c5a3a52-0f55-5b6a-9a6e-1f9f2b1c0d01",
        start=None,
        regime="touch",
        licence="NOASSERTION",
        source={
            "type": "converted",
            "tool": "corpus",
            "tool_version": "1",
            "converter": "octopi/1",
            "key": "egg_0",
            "inputs": [{"name": "egg_0.mov", "sha256": "0" * 64, "bytes": 10}],
            "lossy": [{"step": "resize", "stream": "tactile", "detail": "area, 640x480 to 16x16"}],
        },
        quality=[{"code": "truncated", "message": "the file was cut short", "stream": "tactile"}],
    )
    draft.metadata["annotations"] = {
        "object_id": "egg",
        "part_id": "egg",
        "trial": 0,
        "procedure": "press",
        "pad_type": "plain",
        "labels": [
            {
                "property": "hardness",
                "value": 7.0,
                "scale": [0.0, 10.0],
                "raters": 3,
                "provenance": "human",
            },
            {
                "property": "words",
                "value": ["smooth", "hard"],
                "provenance": "model",
                "origin": "words-of-touch 1.2",
            },
        ],
        "segments": [{"name": "contact", "start_ns": 0, "end_ns": 300_000_000}],
    }
    return draft


def nominal() -> Draft:
    """Return an episode whose time was never measured, with one lost frame."""
    draft = bases.encoded()
    stream = draft.metadata["streams"]["rgb"]
    stream["clock"] = {"source": "none", "stamp_point": "nominal_rate"}
    stream["nominal_rate"] = "60000/1001"
    # multiples of 16683333.3 ns: 0, 1, 3 and 4
    times = np.array([0, 16_683_333, 50_050_000, 66_733_333], dtype=np.int64)
    draft.put("streams/rgb/time", times)
    return draft


def many_chunks() -> Draft:
    """Return an episode whose array is divided into chunks and shards, the last of them partly."""
    draft = bases.wrench()
    draft.put("streams/force/time", bases.times(11), chunk_rows=2, chunks_per_shard=3)
    forces = np.arange(11, dtype=np.float32).reshape(11, 1)
    names = ("time", "component")
    draft.put("streams/force/data", forces, names=names, chunk_rows=3, chunks_per_shard=2)
    return draft


def calibration_array() -> Draft:
    """Return an episode with a calibration that is too big for JSON."""
    draft = bases.poses()
    draft.group("calibration")
    draft.put("calibration/map", np.arange(8, dtype=np.float32).reshape(4, 2), names=("y", "x"))
    draft.metadata["calibration"] = {
        "rectification": {
            "value": None,
            "unit": "px",
            "array": "calibration/map",
            "time": "2026-05-04T10:00:00Z",
            "residual": 0.2,
        }
    }
    return draft


def invalid_samples_flagged() -> Draft:
    """Return an episode in which the device called a value invalid: NaN is honest there."""
    draft = bases.widths()
    width = np.array([0.0, np.nan, 0.02, 0.04], dtype=np.float32)
    draft.put("streams/width/data", width)
    draft.put("streams/width/flags", np.array([0, 8, 0, 0], dtype=np.uint32))
    return draft


def out_of_range_flagged() -> Draft:
    """Return an episode with a width beyond where its calibration holds, which says so."""
    draft = bases.widths()
    draft.metadata["calibration"]["encoder"]["value"]["range_m"] = [0.0, 0.03]
    draft.put("streams/width/flags", np.array([0, 0, 0, 16], dtype=np.uint32))
    return draft


def several_turns() -> Draft:
    """Return an episode of an encoder that turns more than once; its counts fall with the width."""
    draft = bases.mapped()
    points = {"raw": [-5000, -2000, 400], "data": [0.08, 0.03, 0.0]}
    draft.metadata["calibration"]["encoder"]["value"] = {"raw_to_data": points}
    del draft.metadata["streams"]["width"]["raw"]["modulus"]
    counts = np.array([400, -800, -2000, -3500], dtype=np.int32)
    draft.put("streams/width/raw", counts)
    draft.put("streams/width/data", np.array([0.0, 0.015, 0.03, 0.055], dtype=np.float32))
    return draft


def still() -> Draft:
    """Return an episode of a hand that comes to rest, and stands still to the bit."""
    draft = Draft()
    way = np.arange(8.0) ** 2
    places = np.concatenate((way[::-1], np.zeros(40), -way))
    poses = np.zeros((len(places), 7))
    poses[:, 0], poses[:, 6] = places / 4096, 1
    draft.stream("pose", "pose", frames={"parent": "world", "child": "gripper"})
    draft.put("streams/pose/time", bases.times(len(poses), 20_000_000))
    draft.put("streams/pose/data", poses, names=("time", "component"))
    return draft


def lossless_rgb() -> Draft:
    """Return an episode with colour frames stored as compressed pixels."""
    draft = Draft()
    images = bases.images_of("array", height=2, width=3)
    draft.stream("rgb", "rgb", images=images)
    frames = np.arange(36, dtype=np.uint8).reshape(2, 2, 3, 3)
    draft.put("streams/rgb/time", bases.times(2))
    draft.put("streams/rgb/data", frames, names=("time", "y", "x", "c"), chunk_rows=1)
    return draft


def newer_minor() -> Draft:
    """Return an episode of a newer minor version, with nothing that 1.0 does not know."""
    return bases.poses(version="1.9")


def pose_with_raw() -> Draft:
    """Return an episode whose poses were transformed, the device's own kept beside them."""
    draft = bases.poses()
    draft.metadata["calibration"] = {
        "tcp": {"value": [0, 0, 0.1, 0, 0, 0, 1], "unit": "m", "method": "from the drawing"}
    }
    raw = {"unit": "m", "reference_frame": "headset", "transform": "tcp"}
    draft.metadata["streams"]["pose"]["raw"] = raw
    values = np.array(bases.POSES, dtype=np.float32)
    draft.put("streams/pose/raw", values, names=("time", "component"))
    return draft


def valid_cases() -> Iterator[Case]:
    """Yield all valid cases."""
    yield case("streams__none", "No stream at all.", bases.empty())
    yield case("pose__minimal", "One pose stream.", bases.poses())
    yield case("pose__raw_and_transform", "Raw poses beside transformed ones.", pose_with_raw())
    yield case("width__counts_and_calibration", "Encoder counts and widths.", bases.widths())
    about = "A calibration that states the map from counts to widths, over the counts' end."
    yield case("width__calibration_map", about, bases.mapped())
    about = "A calibration over more than a turn, and counts that hold their turns."
    yield case("width__several_turns", about, several_turns())
    yield case("width__invalid_flagged", "NaN where the device says so.", invalid_samples_flagged())
    yield case(
        "width__out_of_range_flagged",
        "A width that its calibration does not reach.",
        out_of_range_flagged(),
    )
    yield case("pose__still", "A hand that stands still.", still())
    yield case("wrench__one_component", "The force of a grip.", bases.wrench())
    yield case("taxels__mask_and_positions", "A grid with a dead cell.", bases.taxels())
    yield case("audio__blocks", "Sound in blocks.", bases.audio())
    yield case("images__encoded", "A camera's JPEG files.", bases.encoded())
    yield case("images__array_uncompressed", "Grey pixels.", bases.pixels())
    yield case("images__array_zstd", "Colour pixels, compressed.", lossless_rgb())
    yield case("images__video", "A video file, verbatim.", bases.video())
    yield case("tactile__reference", "A tactile sensor with reference.", bases.tactile())
    yield case("derived__activity_and_salient", "Derived arrays.", bases.derived())
    yield case("time__clock_corrected", "Offset, drift, latency, flags, gaps.", bases.clocked())
    yield case("time__nominal_rate", "Nominal time with a lost frame.", nominal())
    yield case("time__events", "Samples that come when something happens.", events())
    yield case("time__counted", "A counter, declared gaps, a late sample.", counted())
    yield case("streams__bimanual_multirate", "Two grippers, three rates.", bimanual())
    yield case("arrays__many_chunks", "Chunks, shards, a partly filled end.", many_chunks())
    yield case("calibration__array", "A calibration array.", calibration_array())
    yield case("source__converted_with_labels", "Provenance and labels.", converted())
    yield case("extension__kind_and_keys", "A third party's kind and keys.", bases.extension())
    yield case("sync__grasp", "A grasp in step with the width.", grasp(0))
    yield case("sync__tap", "A tap in step with the pose.", tap(0))
    yield case("version__newer_minor", "Version 1.9.", newer_minor())
    archive = as_zip(bases.derived().files())
    yield packed("packed__derived", "A packed episode.", archive)
    yield dataset("dataset__minimal", "Two episodes and a catalog.")
    split = {"splits/default.json": split_by_part()}
    yield dataset("dataset__split_by_part", "A split by part.", add=split, splits=["default"])
    yield valid_manifest()
