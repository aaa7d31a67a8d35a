"""Invalid cases: groups, files and the documents of arrays."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import Case, Finding, case
from corpus.draft import Draft

__all__ = ["hierarchy_cases"]

DATA = "streams/pose/data"
FILE = f"{DATA}/zarr.json"
CODEC = "/codecs/0/configuration/chunk_shape"


def _sharding(draft: Draft, path: str) -> dict[str, Any]:
    configuration: dict[str, Any] = draft.nodes[path]["codecs"][0]["configuration"]
    return configuration


def _shard_shape(draft: Draft, path: str, shape: list[int]) -> None:
    draft.nodes[path]["chunk_grid"]["configuration"]["chunk_shape"] = shape


def _file_cases() -> Iterator[Case]:
    draft = bases.poses()
    draft.blobs["streams/pose/notes.txt"] = b"recalibrated on Monday\n"
    at = Finding("HIER-001", "streams/pose/notes.txt")
    yield case("HIER-001__notes", "A file among the arrays.", draft, at)
    draft = bases.poses()
    draft.blobs[f"{DATA}/c/1/0"] = draft.blobs[f"{DATA}/c/0/0"]
    at = Finding("HIER-001", f"{DATA}/c/1/0")
    yield case("HIER-001__shard_too_many", "A shard beyond the shape.", draft, at)
    draft = bases.poses()
    del draft.nodes["streams"]
    at = Finding("HIER-002", "streams")
    yield case("HIER-002__streams", "A group without its document.", draft, at)
    draft = bases.poses()
    draft.put("streams/pose/sequence", np.arange(4, dtype=np.uint64), listed=False)
    at = Finding("HIER-003", "streams/pose/sequence")
    yield case("HIER-003__sequence", "An array that is not listed.", draft, at)


def _array_cases() -> Iterator[Case]:
    draft = bases.poses()
    draft.drop(DATA)
    yield case("ARR-001__no_data", "An array is missing.", draft, Finding("ARR-001", DATA))
    draft = bases.widths()
    draft.put("streams/width/data", np.zeros(4))
    at = Finding("ARR-002", "streams/width/data/zarr.json", "/data_type")
    yield case("ARR-002__float64", "Widths in double precision.", draft, at)
    draft = bases.poses()
    draft.put(DATA, np.zeros((4, 6)), names=("time", "component"))
    at = Finding("ARR-003", FILE, "/shape")
    yield case("ARR-003__six_columns", "Poses of six numbers.", draft, at)
    draft = bases.taxels()
    valid = np.ones((2, 3), dtype=np.bool_)
    draft.put("streams/taxels/valid", valid, names=("row", "column"))
    at = Finding("ARR-003", "streams/taxels/valid/zarr.json", "/shape")
    yield case("ARR-003__mask_turned", "A mask lying on its side.", draft, at)
    draft = bases.audio()
    draft.metadata["streams"]["sound"]["channels"] = 1
    at = Finding("ARR-003", "streams/sound/data/zarr.json", "/shape")
    yield case("ARR-003__two_channels", "Two channels of one.", draft, at)


def _document_cases() -> Iterator[Case]:
    draft = bases.poses()
    draft.nodes[DATA]["node_type"] = "group"
    yield case("ZARR-001__group", "A group in an array's place.", draft, Finding("ZARR-001", FILE))
    files = bases.poses().files()
    files[FILE] = files[FILE][:100]
    yield case("ZARR-001__cut", "A document cut short.", files, Finding("ZARR-001", FILE))
    draft = bases.poses()
    draft.nodes[DATA]["data_type"] = "complex128"
    at = Finding("ZARR-002", FILE, "/data_type")
    yield case("ZARR-002__complex", "Complex numbers.", draft, at)
    at = Finding("ZARR-003", FILE, "/codecs")
    draft = bases.poses()
    _sharding(draft, DATA)["codecs"][1] = {"name": "gzip", "configuration": {"level": 5}}
    yield case("ZARR-003__gzip", "Another compression.", draft, at)
    draft = bases.poses()
    _sharding(draft, DATA)["codecs"][1]["configuration"]["checksum"] = False
    yield case("ZARR-003__no_checksum", "Compressed without a checksum.", draft, at)
    draft = bases.poses()
    _sharding(draft, DATA)["codecs"][0]["configuration"]["endian"] = "big"
    yield case("ZARR-003__big_endian", "Big endian.", draft, at)
    draft = bases.poses()
    draft.nodes[DATA]["dimension_names"] = ["t", "component"]
    at = Finding("ZARR-005", FILE, "/dimension_names")
    yield case("ZARR-005__t", "The first axis has another name.", draft, at)
    draft = bases.poses()
    consolidated = {"kind": "inline", "must_understand": False, "metadata": {}}
    draft.root["consolidated_metadata"] = consolidated
    at = Finding("ZARR-006", "zarr.json", "/consolidated_metadata")
    yield case("ZARR-006__root", "Consolidated metadata.", draft, at)
    draft = bases.poses()
    draft.nodes[DATA]["attributes"] = {"unit": "mm"}
    at = Finding("ZARR-007", FILE, "/attributes")
    yield case("ZARR-007__unit", "A unit beside the metadata.", draft, at)
    draft = bases.poses()
    keys = {"name": "default", "configuration": {"separator": "."}}
    draft.nodes[DATA]["chunk_key_encoding"] = keys
    at = Finding("ZARR-009", FILE, "/chunk_key_encoding")
    yield case("ZARR-009__dots", "Chunk keys with dots.", draft, at)


def _member_cases() -> Iterator[Case]:
    """Yield documents that Zarr libraries refuse."""
    at = Finding("ZARR-001", FILE)
    for name, value in (("text", "abc"), ("null", None)):
        draft = bases.poses()
        draft.nodes[DATA]["fill_value"] = value
        yield case(f"ZARR-001__fill_value_{name}", "No number to fill with.", draft, at)
    draft = bases.poses()
    draft.nodes["streams/pose/time"]["fill_value"] = 0.5
    found = Finding("ZARR-001", "streams/pose/time/zarr.json")
    yield case("ZARR-001__fill_value_half", "Half a nanosecond to fill with.", draft, found)
    for name, node in (("array", DATA), ("group", "streams/pose")):
        draft = bases.poses()
        draft.nodes[node]["made_by"] = {"tool": "corpus"}
        found = Finding("ZARR-001", f"{node}/zarr.json")
        yield case(f"ZARR-001__member_of_{name}", "A member that Zarr lacks.", draft, found)
    draft = bases.poses()
    draft.root["made_by"] = {"tool": "corpus"}
    found = Finding("ZARR-001", "zarr.json")
    yield case("ZARR-001__member_of_root", "A member that Zarr lacks.", draft, found)
    draft = bases.poses()
    draft.nodes[DATA]["dimension_names"] = ["time", 5]
    found = Finding("ZARR-005", FILE, "/dimension_names")
    yield case("ZARR-005__number", "A number for a name.", draft, found)
    draft = bases.poses()
    draft.nodes[DATA]["chunk_grid"]["configuration"]["order"] = "C"
    found = Finding("ZARR-008", FILE, "/chunk_grid")
    yield case("ZARR-008__member", "A grid with a member that Zarr lacks.", draft, found)
    at = Finding("ZARR-003", FILE, "/codecs")
    draft = bases.poses()
    _sharding(draft, DATA)["order"] = "C"
    yield case("ZARR-003__member_of_sharding", "Sharding with a member of its own.", draft, at)
    for name, configuration in (
        ("member_of_zstd", {"level": 3, "checksum": True, "window": 20}),
        ("level_hi", {"level": "hi", "checksum": True}),
        ("level_99", {"level": 99, "checksum": True}),
        ("no_level", {"checksum": True}),
    ):
        draft = bases.poses()
        _sharding(draft, DATA)["codecs"][1]["configuration"] = configuration
        yield case(f"ZARR-003__{name}", "zstd, configured otherwise.", draft, at)
    draft = bases.poses()
    _sharding(draft, DATA)["index_codecs"][1] = "crc32c"
    yield case("ZARR-003__name_alone", "A codec that is only a name.", draft, at)


def _grid_cases() -> Iterator[Case]:
    draft = bases.poses()
    rows = 1 << 21  # of 56 bytes
    _shard_shape(draft, DATA, [rows, 7])
    _sharding(draft, DATA)["chunk_shape"] = [rows, 7]
    at = Finding("ZARR-004", FILE, CODEC)
    yield case("ZARR-004__112_megabytes", "A shard of 112 MiB.", draft, at)
    draft = bases.poses()
    _sharding(draft, DATA)["chunk_shape"] = [3, 7]
    at = Finding("ZARR-008", FILE, CODEC)
    yield case("ZARR-008__three_of_four", "Chunks that do not fill a shard.", draft, at)
    draft = bases.poses()
    _sharding(draft, DATA)["chunk_shape"] = None
    yield case("ZARR-008__no_size", "Chunks of no size.", draft, at)
    draft = bases.poses()
    _shard_shape(draft, DATA, [4, 1])
    at = Finding("ZARR-008", FILE, "/chunk_grid")
    yield case("ZARR-008__second_axis", "Shards that divide a pose.", draft, at)
    draft = bases.poses()
    draft.nodes[DATA]["shape"] = [1 << 40, 7]
    at = Finding("ZARR-010", FILE, "/shape")
    yield case("ZARR-010__endless", "A shape that nobody can store.", draft, at)
    draft = bases.pixels()
    frames = (np.arange(64, dtype=np.uint8) * 3).reshape(4, 4, 4, 1)
    names = ("time", "y", "x", "c")
    draft.put("streams/rgb/data", frames, names=names, chunk_rows=2, zstd=False)
    at = Finding("IMG-002", "streams/rgb/data/zarr.json", CODEC)
    yield case("IMG-002__two_frames", "Two frames a chunk.", draft, at)
    draft = bases.encoded()
    data = np.frombuffer(b"".join(bases.jpegs()), dtype=np.uint8)
    at = Finding("IMG-003", "streams/rgb/data/zarr.json", CODEC)
    draft.put("streams/rgb/data", data, names=("byte",), zstd=False, chunk_rows=1024)
    yield case("IMG-003__small_chunks", "Chunks of 1 KiB.", draft, at)
    draft = bases.encoded()
    draft.put("streams/rgb/data", data, names=("byte",))
    yield case("IMG-003__compressed", "JPEG files, compressed again.", draft, at)


def _derived_cases() -> Iterator[Case]:
    draft = bases.derived()
    draft.drop("derived/tactile/salient")
    at = Finding("DRV-002", "derived/tactile/salient")
    yield case("DRV-002__not_there", "Described, but not there.", draft, at)
    draft = bases.derived()
    del draft.nodes["derived"]["attributes"]["exumi"]["items"]["tactile/salient"]
    yield case("DRV-002__not_described", "There, but not described.", draft, at)


def hierarchy_cases() -> Iterator[Case]:
    """Yield the cases of the level of the hierarchy, packing apart."""
    yield from _file_cases()
    yield from _array_cases()
    yield from _document_cases()
    yield from _member_cases()
    yield from _grid_cases()
    yield from _derived_cases()
