"""Invalid cases: what the metadata says of streams."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import EXUMI, Case, Finding, case
from corpus.draft import Draft

__all__ = ["stream_cases"]

ROOT = "zarr.json"


def _at(*keys: str) -> str:
    return "/".join((EXUMI, "streams", *keys))


def _stream(draft: Draft, name: str) -> dict[str, Any]:
    stream: dict[str, Any] = draft.metadata["streams"][name]
    return stream


def _kind_cases() -> Iterator[Case]:
    draft = bases.poses()
    _stream(draft, "pose")["kind"] = "imu"
    at = Finding("KIND-001", ROOT, _at("pose", "kind"))
    yield case("KIND-001__reserved", "A kind that is reserved.", draft, at)
    draft = bases.extension()
    del _stream(draft, "current")["schema_url"]
    at = Finding("EXT-001", ROOT, _at("current", "schema_url"))
    yield case("EXT-001__no_schema", "An extension without its schema.", draft, at)
    draft = bases.extension()
    del draft.metadata["acme:rig"]["schema_url"]
    at = Finding("EXT-002", ROOT, f"{EXUMI}/acme:rig")
    yield case("EXT-002__no_schema", "A third party's object without its schema.", draft, at)


def _array_cases() -> Iterator[Case]:
    draft = bases.encoded()
    draft.drop("streams/rgb/crc32c")
    _stream(draft, "rgb")["arrays"].remove("crc32c")
    at = Finding("STRM-001", ROOT, _at("rgb", "arrays"))
    yield case("STRM-001__no_checksums", "Frames without checksums.", draft, at)
    draft = bases.poses()
    draft.put("streams/pose/velocity", np.zeros((4, 3)), names=("time", "component"))
    at = Finding("STRM-002", ROOT, _at("pose", "arrays"))
    yield case("STRM-002__velocity", "A pose stream with velocities.", draft, at)
    draft = bases.poses()
    _stream(draft, "pose")["arrays"].append("data")
    at = Finding("STRM-003", ROOT, _at("pose", "arrays"))
    yield case("STRM-003__data_twice", "An array that is listed twice.", draft, at)
    draft = bases.widths()
    del _stream(draft, "width")["raw"]
    at = Finding("RAW-001", ROOT, _at("width", "raw"))
    yield case("RAW-001__not_described", "Raw values of what?", draft, at)
    draft = bases.widths()
    _stream(draft, "width")["raw"]["transform"] = "gear"
    at = Finding("RAW-002", ROOT, _at("width", "raw", "transform"))
    yield case("RAW-002__no_calibration", "A transform that is not there.", draft, at)


def _clock_cases() -> Iterator[Case]:
    draft = bases.poses()
    _stream(draft, "pose")["clock"]["latency_ns"] = 60_000_000
    at = Finding("CLOCK-001", ROOT, _at("pose", "clock"))
    yield case("CLOCK-001__latency_without_raw", "Corrected from what?", draft, at)
    draft = bases.poses()
    _stream(draft, "pose")["clock"]["raw_time"] = "time_host"
    at = Finding("CLOCK-002", ROOT, _at("pose", "clock", "raw_time"))
    yield case("CLOCK-002__no_array", "A raw time that is not there.", draft, at)
    draft = bases.poses()
    _stream(draft, "pose")["clock"] = {"source": "none", "stamp_point": "nominal_rate"}
    at = Finding("CLOCK-003", ROOT, _at("pose"))
    yield case("CLOCK-003__no_rate", "Nominal time without a rate.", draft, at)
    draft = bases.poses()
    _stream(draft, "pose")["clock"] = {"source": "none", "stamp_point": "nominal_rate"}
    _stream(draft, "pose")["nominal_rate"] = "10"
    draft.put("streams/pose/time_host", bases.times(4))
    at = Finding("CLOCK-003", ROOT, _at("pose", "arrays"))
    yield case("CLOCK-003__measured", "Nominal time that was measured.", draft, at)
    draft = bases.clocked()
    del _stream(draft, "pose")["time_device_unit"]
    at = Finding("CLOCK-004", ROOT, _at("pose", "time_device_unit"))
    yield case("CLOCK-004__no_unit", "The device's time, in what?", draft, at)


def _image_cases() -> Iterator[Case]:
    draft = Draft()
    images = bases.images_of("encoded", height=60_000, width=60_000)
    draft.stream("rgb", "rgb", images=images)
    bases.put_encoded(draft, "rgb", [])
    at = Finding("IMG-001", ROOT, _at("rgb", "images"))
    empty = Finding("STRM-004", "streams/rgb/time")
    yield case("IMG-001__ten_gigabytes", "A frame of 10 GB.", draft, at, empty)
    draft = Draft()
    draft.stream("rgb", "rgb", images=bases.images_of("array", height=8193, width=8192, channels=1))
    draft.put("streams/rgb/time", bases.times(0))
    names = ("time", "y", "x", "c")
    draft.put("streams/rgb/data", np.zeros((0, 8193, 8192, 1), np.uint8), names=names)
    shard = Finding("ZARR-004", "streams/rgb/data/zarr.json", "/codecs/0/configuration/chunk_shape")
    about = "Pixels of a frame that no shard can hold."
    yield case("IMG-001__beyond_a_shard", about, draft, at, empty, shard)
    draft = bases.tactile()
    del _stream(draft, "tactile")["reference"]
    at = Finding("TACT-001", ROOT, _at("tactile", "reference"))
    yield case("TACT-001__not_described", "A reference from where?", draft, at)
    draft = bases.tactile()
    del _stream(draft, "tactile")["reference"]
    draft.drop("streams/tactile/reference")
    _stream(draft, "tactile")["arrays"].remove("reference")
    at = Finding("TACT-002", ROOT, _at("tactile"))
    yield case("TACT-002__no_reference", "A tactile stream without reference.", draft, at)


def _grid_cases() -> Iterator[Case]:
    draft = bases.wrench()
    _stream(draft, "force")["components"] = ["fx", "fx"]
    values = np.zeros((4, 2), dtype=np.float32)
    draft.put("streams/force/data", values, names=("time", "component"))
    at = Finding("WRENCH-001", ROOT, _at("force", "components"))
    yield case("WRENCH-001__fx_twice", "Two columns of one name.", draft, at)
    draft = bases.taxels()
    _stream(draft, "taxels")["positions_m"].pop()
    at = Finding("TAX-001", ROOT, _at("taxels", "positions_m"))
    yield case("TAX-001__five_of_six", "Five positions of six cells.", draft, at)


def stream_cases() -> Iterator[Case]:
    """Yield the cases of the metadata of streams."""
    yield from _kind_cases()
    yield from _array_cases()
    yield from _clock_cases()
    yield from _image_cases()
    yield from _grid_cases()
