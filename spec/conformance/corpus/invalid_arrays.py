"""Invalid cases: shards, lengths, times and values."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases, zstd_frames
from corpus.case import EXUMI, Case, Finding, case
from corpus.draft import Draft, crc32c
from corpus.valid_videos import corrected, stamped_by_the_host

__all__ = ["array_cases"]

POSE = "streams/pose"
SHARD = f"{POSE}/data/c/0/0"
ROOT = "zarr.json"


def _index_of(shard: bytes, chunks: int) -> tuple[bytes, np.ndarray]:
    """Split a shard into its chunks and its index."""
    length = chunks * 16 + 4
    return shard[:-length], np.frombuffer(shard[-length:-4], dtype="<u8").reshape(-1, 2).copy()


def _shard_of(body: bytes, index: np.ndarray) -> bytes:
    raw = index.tobytes()
    return body + raw + crc32c(raw).to_bytes(4, "little")


def _shard_cases() -> Iterator[Case]:
    draft = bases.poses()
    draft.drop(SHARD)
    at = Finding("SHARD-001", f"{POSE}/data")
    yield case("SHARD-001__deleted", "A shard is missing.", draft, at)
    draft = bases.poses()
    draft.nodes[f"{POSE}/time"]["shape"] = [12_500_000_000]
    shards = [4096]
    draft.nodes[f"{POSE}/time"]["chunk_grid"]["configuration"]["chunk_shape"] = shards
    sharding = draft.nodes[f"{POSE}/time"]["codecs"][0]["configuration"]
    sharding["chunk_shape"] = shards
    at = Finding("SHARD-001", f"{POSE}/time")
    yield case("SHARD-001__100_gigabytes", "A shape that asks for 100 GB.", draft, at)
    draft = bases.poses()
    draft.blobs[SHARD] = draft.blobs[SHARD][:-1] + bytes([draft.blobs[SHARD][-1] ^ 1])
    at = Finding("SHARD-002", SHARD)
    yield case("SHARD-002__index_checksum", "A damaged index.", draft, at)
    draft = bases.poses()
    draft.blobs[SHARD] = draft.blobs[SHARD][:10]
    yield case("SHARD-002__cut", "A shard cut short.", draft, at)
    draft = bases.pixels()
    frames = "streams/rgb/data/c/0/0/0/0"
    body, index = _index_of(draft.blobs[frames], 4)
    index[2] = 0xFFFFFFFFFFFFFFFF
    draft.blobs[frames] = _shard_of(body, index)
    at = Finding("SHARD-003", frames, index=2)
    yield case("SHARD-003__absent_chunk", "A chunk that reads as zeros.", draft, at)
    draft = bases.pixels()
    body, index = _index_of(draft.blobs[frames], 4)
    index[[1, 2]] = index[[2, 1]]
    draft.blobs[frames] = _shard_of(body, index)
    at = Finding("SHARD-004", frames, index=1)
    yield case("SHARD-004__swapped", "Two chunks in the wrong order.", draft, at)


def _chunk_cases() -> Iterator[Case]:
    draft = bases.poses()
    draft.blobs[SHARD] = draft.blobs[SHARD][:-20] + b"free" + draft.blobs[SHARD][-20:]
    at = Finding("SHARD-006", SHARD)
    yield case("SHARD-006__four_bytes", "Four bytes too many.", draft, at)
    draft = bases.poses()
    shard = bytearray(draft.blobs[SHARD])
    shard[40] ^= 1
    draft.blobs[SHARD] = bytes(shard)
    at = Finding("SHARD-005", f"{POSE}/data")
    yield case("SHARD-005__flipped_bit", "A flipped bit in compressed data.", draft, at)
    draft = bases.poses()
    draft.put(f"{POSE}/data", np.array(bases.POSES[:3]), names=("time", "component"))
    at = Finding("ARR-004", f"{POSE}/data/zarr.json", "/shape")
    yield case("ARR-004__three_of_four", "Three poses at four times.", draft, at)
    draft = bases.derived()
    activity = np.zeros(5, dtype=np.float32)
    draft.put("derived/tactile/activity", activity)
    at = Finding("ARR-004", "derived/tactile/activity/zarr.json", "/shape")
    yield case("ARR-004__activity", "Activity of five frames of four.", draft, at)


def _length_cases() -> Iterator[Case]:
    """Chunks that are shorter or longer than the document says, in a sound shard."""
    times = f"{POSE}/time/c/0"
    for name, count in (("short", 3), ("long", 5)):
        draft = bases.poses()
        rows = np.array([0, 1, 2, 3, 4][:count], dtype=np.int64) * bases.FRAME_NS
        chunk = zstd_frames.frame(rows.tobytes())
        draft.blobs[times] = _shard_of(chunk, np.array([[0, len(chunk)]], dtype="<u8"))
        at = Finding("SHARD-005", f"{POSE}/time")
        about = f"A compressed chunk of {count} samples in place of four."
        yield case(f"SHARD-005__{name}_compressed", about, draft, at)
    frames = "streams/rgb/data/c/0/0/0/0"
    for name, change in (("short", -4), ("long", 4)):
        draft = bases.pixels()
        body, index = _index_of(draft.blobs[frames], 4)
        body = body + bytes(change) if change > 0 else body[:change]
        index[3, 1] = int(index[3, 1]) + change
        draft.blobs[frames] = _shard_of(body, index)
        at = Finding("SHARD-005", "streams/rgb/data")
        about = f"An uncompressed frame of {16 + change} bytes in place of 16."
        yield case(f"SHARD-005__{name}_uncompressed", about, draft, at)


def _with_time(draft: Draft, values: list[int]) -> Draft:
    draft.put(f"{POSE}/time", np.array(values, dtype=np.int64))
    return draft


def _time_cases() -> Iterator[Case]:
    time = f"{POSE}/time"
    draft = _with_time(bases.poses(), [0, 100, 100, 300])
    at = Finding("TIME-001", time, index=2)
    yield case("TIME-001__tie", "Two samples at one time.", draft, at)
    draft = _with_time(bases.poses(), [0, 100, 200, 1 << 62])
    at = Finding("TIME-002", time, index=3)
    yield case("TIME-002__146_years", "A time beyond 146 years.", draft, at)
    draft = bases.clocked()
    draft.metadata["streams"]["pose"]["clock"]["latency_ns"] = 13_000_000
    at = Finding("TIME-003", time, index=0)
    yield case("TIME-003__latency_changed", "A latency that was changed alone.", draft, at)
    draft = _with_time(bases.poses(), [0, 100_000_000, 230_000_000, 300_000_000])
    stream = draft.metadata["streams"]["pose"]
    stream["clock"] = {"source": "none", "stamp_point": "nominal_rate"}
    stream["nominal_rate"] = "10"
    at = Finding("TIME-004", time, index=2)
    yield case("TIME-004__jitter", "Nominal time that jitters.", draft, at)
    draft = bases.poses()
    draft.put(f"{POSE}/sequence", np.array([1, 2, 2, 3], dtype=np.uint64))
    at = Finding("SEQ-001", f"{POSE}/sequence", index=2)
    yield case("SEQ-001__repeated", "A sample that came twice.", draft, at)
    draft = bases.poses()
    draft.put(f"{POSE}/flags", np.array([0, 0, 64, 0], dtype=np.uint32))
    at = Finding("FLAG-001", f"{POSE}/flags", index=2)
    yield case("FLAG-001__bit_6", "A flag that nobody knows.", draft, at)
    draft = bases.poses()
    draft.metadata["streams"]["pose"]["gaps"] = [{"after": 9, "lost": 1}]
    at = Finding("GAP-001", ROOT, f"{EXUMI}/streams/pose/gaps/0/after", 0)
    yield case("GAP-001__beyond_the_end", "A gap after the end.", draft, at)
    draft = Draft()
    draft.stream("width", "width", gaps=[{"after": -1}, {"after": 0}])
    draft.put("streams/width/time", bases.times(0))
    draft.put("streams/width/data", np.zeros(0, dtype=np.float32))
    at = Finding("GAP-001", ROOT, f"{EXUMI}/streams/width/gaps/1/after", 1)
    empty = Finding("STRM-004", "streams/width/time")
    yield case("GAP-001__of_nothing", "A gap after the first of no samples.", draft, at, empty)


def _value_cases() -> Iterator[Case]:
    data = "streams/width/data"

    def widths(*values: float, **metadata: Any) -> Draft:
        draft = bases.widths(**metadata)
        draft.put(data, np.array(values, dtype=np.float32))
        return draft

    draft = widths(0.0, np.nan, 0.02, 0.04)
    at = Finding("VAL-001", data, index=1)
    yield case("VAL-001__nan", "NaN in place of a width.", draft, at)
    draft = widths(0.0, 0.01, -0.02, 0.04)
    at = Finding("WIDTH-001", data, index=2)
    yield case("WIDTH-001__negative", "A width of minus 2 cm.", draft, at)
    draft = widths(0.0, 0.01, 0.02, 0.5, embodiment={"name": "umi", "max_width_m": 0.085})
    at = Finding("WIDTH-002", data, index=3)
    yield case("WIDTH-002__half_a_metre", "A hand that opens half a metre.", draft, at)
    draft = bases.widths()
    draft.put("streams/width/raw", np.array([100, 200, 4096, 500], dtype=np.uint16))
    at = Finding("RAW-003", "streams/width/raw", index=2)
    yield case("RAW-003__4096", "4096 of a counter that wraps there.", draft, at)
    poses = np.array(bases.POSES)
    poses[2, 3:] *= 2
    draft = bases.poses()
    draft.put(f"{POSE}/data", poses, names=("time", "component"))
    at = Finding("POSE-001", f"{POSE}/data", index=2)
    yield case("POSE-001__norm_2", "A quaternion of norm 2.", draft, at)
    poses = np.array(bases.POSES)
    poses[2:, 3:] *= -1
    draft = bases.poses()
    draft.put(f"{POSE}/data", poses, names=("time", "component"))
    at = Finding("POSE-002", f"{POSE}/data", index=2)
    yield case("POSE-002__flip", "A quaternion that changes its sign.", draft, at)
    draft = bases.tactile()
    draft.metadata["streams"]["tactile"]["reference"] = {"method": "selected", "frames": [0, 7]}
    at = Finding("TACT-003", ROOT, f"{EXUMI}/streams/tactile/reference/frames/1")
    yield case("TACT-003__frame_7", "A reference from a frame that is not there.", draft, at)
    draft = bases.derived()
    activity = np.array([0, 0.25, 1.5, 0.1], dtype=np.float32)
    draft.put("derived/tactile/activity", activity)
    at = Finding("DRV-004", "derived/tactile/activity", index=2)
    yield case("DRV-004__150_percent", "150 % of the pixels.", draft, at)
    draft = bases.derived()
    salient = np.array([2, 1], dtype=np.int64)
    draft.put("derived/tactile/salient", salient, names=("index",))
    at = Finding("DRV-005", "derived/tactile/salient", index=1)
    yield case("DRV-005__unsorted", "Salient frames out of order.", draft, at)


def _sound_cases() -> Iterator[Case]:
    path = "streams/sound/offset"
    draft = bases.audio()
    draft.put(path, np.array([0, 80, 80, 200, 280], dtype=np.uint64), names=("edge",))
    at = Finding("AUD-001", path, index=2)
    yield case("AUD-001__empty_block", "A block without samples.", draft, at)
    draft = bases.audio()
    draft.put(path, np.array([0, 80, 160, 200, 281], dtype=np.uint64), names=("edge",))
    yield case("AUD-001__beyond", "A block beyond the sound.", draft, Finding("AUD-001", path))
    draft = bases.audio()
    draft.put(path, np.array([80, 100, 160, 200, 280], dtype=np.uint64), names=("edge",))
    at = Finding("AUD-001", path, index=0)
    yield case("AUD-001__start", "Sound that belongs to no block.", draft, at)


def _frame_cases() -> Iterator[Case]:
    draft = bases.encoded()
    sizes = [len(file) for file in bases.jpegs()]
    edges = np.cumsum([0, *sizes]).astype(np.uint64)
    edges[2], edges[3] = edges[3], edges[2]
    draft.put("streams/rgb/offset", edges, names=("edge",))
    at = Finding("IMG-004", "streams/rgb/offset", index=3)
    yield case("IMG-004__back", "An offset that goes back.", draft, at)
    draft = bases.video()
    draft.metadata["streams"]["rgb"]["images"]["files"][0]["bytes"] += 1
    at = Finding("VID-001", "streams/rgb/offset")
    yield case("VID-001__one_byte", "A file that is a byte too short.", draft, at)
    draft = bases.video()
    draft.put("streams/rgb/file", np.array([0, 0, 0, 0, 0, 0, 0, 1], dtype=np.uint32))
    at = Finding("VID-002", "streams/rgb/file", index=7)
    yield case("VID-002__second_file", "A frame of a file that is not there.", draft, at)
    draft = bases.video()
    stream = draft.metadata["streams"]["rgb"]
    stream["clock"] = {**stream["clock"], "raw_time": "time_host"}
    draft.put("streams/rgb/time_host", bases.times(8))
    pts = np.arange(8, dtype=np.int64) * 1024
    pts[[5, 6]] = pts[[6, 5]]
    draft.put("streams/rgb/pts", pts)
    at = Finding("VID-003", "streams/rgb/pts", index=6)
    yield case("VID-003__swapped", "Two presentation times swapped.", draft, at)
    draft = bases.video()
    keyframe = np.array([0, 0, 0, 4, 4, 4, 4, 4], dtype=np.uint64)
    draft.put("streams/rgb/keyframe", keyframe)
    at = Finding("VID-004", "streams/rgb/keyframe", index=3)
    yield case("VID-004__forward", "A keyframe in the future.", draft, at)
    draft = bases.video()
    time = bases.times(8)
    time[3] += 5_000_000
    draft.put("streams/rgb/time", time)
    at = Finding("VID-005", "streams/rgb/time", index=3)
    yield case("VID-005__moved", "A time that the file does not know.", draft, at)
    draft = corrected()
    draft.put("streams/rgb/time", bases.times(8) + 5_000_000_000)
    at = Finding("VID-005", "streams/rgb/time", index=0)
    yield case("VID-005__not_corrected", "The pts' times, as if there were no clock.", draft, at)
    draft = stamped_by_the_host()
    draft.put("streams/rgb/time", bases.times(8))
    at = Finding("TIME-003", "streams/rgb/time", index=1)
    yield case("TIME-003__of_pts", "The pts' times where stamps are the raw times.", draft, at)


def _finite_cases() -> Iterator[Case]:
    data = "streams/width/data"
    draft = bases.widths()
    draft.put(data, np.array([0.0, 0.01, np.inf, 0.04], dtype=np.float32))
    draft.put("streams/width/flags", np.array([0, 0, 8, 0], dtype=np.uint32))
    at = Finding("VAL-001", data, index=2)
    yield case("VAL-001__infinite", "An infinite width, though not a valid one.", draft, at)
    draft = bases.widths()
    del draft.metadata["streams"]["width"]["raw"]["modulus"]
    draft.put("streams/width/raw", np.array([0.0, 1.0, 2.0, np.nan]))
    at = Finding("VAL-001", "streams/width/raw", index=3)
    yield case("VAL-001__raw", "NaN in place of what the device said.", draft, at)


def array_cases() -> Iterator[Case]:
    """Yield the cases of the level of arrays."""
    yield from _shard_cases()
    yield from _chunk_cases()
    yield from _length_cases()
    yield from _time_cases()
    yield from _value_cases()
    yield from _finite_cases()
    yield from _sound_cases()
    yield from _frame_cases()
