"""Arrays are written as any Zarr reader wants them, and read back by offset."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
import zarr.codecs
from hypothesis import given, settings
from hypothesis import strategies as st
from numcodecs.zstd import Zstd

from exumi_data.errors import DamagedDataError, LimitError, UnsupportedError, UsageError
from exumi_data.store.access import FolderStore
from exumi_data.store.shards import ArrayReader, ArrayWriter, Bytes, crc32c, open_array
from exumi_data.store.zarr_document import DTYPES, MAX_SHARD_BYTES, parse_array

ABSENT = 0xFFFFFFFFFFFFFFFF


def values_of(dtype: str, shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """Random bits, but finite numbers, so that arrays can be compared."""
    generator = np.random.default_rng(seed)
    if dtype == "bool":
        return generator.integers(0, 2, shape).astype(bool)
    if dtype.startswith("float"):
        return generator.normal(size=shape).astype(dtype)
    limits = np.iinfo(dtype)
    return generator.integers(limits.min, limits.max, shape, dtype=dtype, endpoint=True)


def write(
    folder: Path, values: np.ndarray, *, cuts: tuple[int, ...] = (), **options: Any
) -> ArrayWriter:
    """Write an array in several appends."""
    options = {"chunk_rows": 4, "zstd": False, **options}
    writer = ArrayWriter(folder, values.dtype, values.shape[1:], **options)
    edges = [0, *sorted(min(cut, len(values)) for cut in cuts), len(values)]
    for start, stop in pairwise(edges):
        writer.append(values[start:stop])
    writer.finish()
    return writer


def opened(root: Path, name: str = "a") -> ArrayReader:
    return open_array(FolderStore(root), name)


def fast(root: Path, name: str = "a") -> ArrayReader:
    reader = opened(root, name)
    assert isinstance(reader, ArrayReader)
    return reader


def shard_files(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / "c").rglob("*") if path.is_file())


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder for one example: hypothesis runs many in one test."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def index_of(shard: Path, chunks: int) -> np.ndarray:
    return np.frombuffer(shard.read_bytes()[-16 * chunks - 4 : -4], "<u8").reshape(-1, 2).copy()


def with_index(body: bytes, index: np.ndarray) -> bytes:
    """A shard whose index has a right checksum, whatever it says."""
    raw = index.astype("<u8").tobytes()
    return body + raw + crc32c(raw).to_bytes(4, "little")


# --------------------------------------------------------------------------------------- round trip


@settings(max_examples=150)
@given(
    dtype=st.sampled_from(sorted(DTYPES)),
    rows=st.integers(0, 40),
    row_shape=st.lists(st.integers(1, 3), max_size=3).map(tuple),
    chunk_rows=st.integers(1, 12),
    zstd=st.booleans(),
    cuts=st.lists(st.integers(0, 40), max_size=5).map(tuple),
    shard_bytes=st.sampled_from([1, 64, 500, 32 << 20]),
)
def test_what_is_written_is_read_by_us_and_by_zarr(
    dtype: str,
    rows: int,
    row_shape: tuple[int, ...],
    chunk_rows: int,
    zstd: bool,
    cuts: tuple[int, ...],
    shard_bytes: int,
) -> None:
    values = values_of(dtype, (rows, *row_shape))
    with temporary_folder() as root:
        options: dict[str, Any] = {"chunk_rows": chunk_rows, "zstd": zstd}
        write(root / "a", values, cuts=cuts, shard_bytes=shard_bytes, **options)
        reader = fast(root)
        read = reader.read()
        assert read.dtype == values.dtype
        np.testing.assert_array_equal(read, values)
        foreign: Any = zarr.open_array(root / "a", mode="r")
        assert foreign.dtype == values.dtype
        assert foreign.shape == values.shape
        np.testing.assert_array_equal(foreign[...], values)
        reader.check_shards()
        memory = values.tobytes()
        assert reader.bytes_at(0, len(memory)) == memory
        middle = len(memory) // 3
        assert reader.bytes_at(middle, len(memory) // 2) == memory[middle:][: len(memory) // 2]


@pytest.mark.parametrize("zstd", [False, True])
@pytest.mark.parametrize("rows", [0, 1, 3, 4, 5, 8, 9, 31, 32, 33])
def test_every_inner_chunk_within_the_shape_is_there(tmp_path: Path, rows: int, zstd: bool) -> None:
    # 4 rows a chunk, 4 chunks a shard; all of them zeros, which a writer may be tempted to skip.
    write(tmp_path / "a", np.zeros((rows, 2), "<i4"), zstd=zstd, shard_bytes=128)
    document = fast(tmp_path).document
    files = shard_files(tmp_path / "a")
    assert len(files) == document.shards == -(-rows // document.shard_rows)
    present = [index_of(file, document.chunks_per_shard)[:, 0] != ABSENT for file in files]
    assert sum(map(sum, present)) == -(-rows // document.chunk_rows)
    for shard, chunks in enumerate(present):
        here = min(document.shard_rows, rows - shard * document.shard_rows)
        assert chunks[: -(-here // document.chunk_rows)].all()


def test_a_short_array_has_one_chunk_of_its_own_length(tmp_path: Path) -> None:
    write(tmp_path / "a", np.arange(3), chunk_rows=8192)
    document = fast(tmp_path).document
    assert (document.chunk_rows, document.shard_rows) == (3, 3)
    assert shard_files(tmp_path / "a")[0].stat().st_size == 3 * 8 + 16 + 4


@pytest.mark.parametrize("zstd", [False, True])
def test_shards_stay_below_64_mib(tmp_path: Path, zstd: bool) -> None:
    # Rows of one byte have the most index for their data; noise does not get smaller by zstd.
    values = np.random.default_rng(0).integers(0, 256, (3 << 20,), dtype=np.uint8)
    options: dict[str, Any] = {"chunk_rows": 1, "zstd": zstd, "shard_bytes": 1 << 40}
    document = ArrayWriter(tmp_path / "tiny", "u1", (), **options)
    largest = document._chunks_per_shard * (1 + 16 + 13 * zstd) + 4
    assert largest <= MAX_SHARD_BYTES
    write(tmp_path / "a", values, chunk_rows=1 << 20, zstd=zstd, shard_bytes=2 << 20)
    assert max(file.stat().st_size for file in shard_files(tmp_path / "a")) <= (2 << 20) + 200


def test_a_chunk_that_does_not_fit_into_a_shard_gets_fewer_rows(tmp_path: Path) -> None:
    writer = ArrayWriter(tmp_path / "a", "f4", (1024, 1024), chunk_rows=8192, zstd=True)
    writer.append(np.zeros((9, 1024, 1024), "f4"))
    document = writer.finish()
    assert document.chunk_bytes <= 32 << 20
    assert document.shape == (9, 1024, 1024)
    np.testing.assert_array_equal(fast(tmp_path).rows(8, 9), np.zeros((1, 1024, 1024)))


def test_the_document_says_no_more_than_zarr_needs(tmp_path: Path) -> None:
    write(tmp_path / "a", np.zeros((2, 3), ">f4"), dimension_names=("time", "axis"), zstd=True)
    document = json.loads((tmp_path / "a" / "zarr.json").read_bytes())
    assert document["dimension_names"] == ["time", "axis"]
    assert document["fill_value"] == 0
    assert document["attributes"] == {}
    (sharding,) = document["codecs"]
    assert sharding["configuration"]["index_location"] == "end"
    foreign: Any = zarr.open_array(tmp_path / "a", mode="r")
    assert foreign.metadata.dimension_names == ("time", "axis")


def test_bytes_are_appended_as_they_come(tmp_path: Path) -> None:
    writer = ArrayWriter(tmp_path / "a", "u1", (), chunk_rows=16, zstd=False, shard_bytes=64)
    pieces: list[Bytes] = [b"", b"abc", bytearray(40), memoryview(b"x" * 100), b"end"]
    for piece in pieces:
        writer.append_bytes(piece)
    writer.finish()
    whole = b"".join(bytes(piece) for piece in pieces)
    reader = fast(tmp_path)
    assert [reader.is_contiguous(shard) for shard in range(reader.document.shards)] == [True] * 3
    for start, stop in ((0, 146), (60, 70), (63, 65), (64, 128), (140, 146), (146, 146)):
        assert reader.bytes_at(start, stop - start) == whole[start:stop]
    for start, length in ((-1, 3), (145, 2), (0, 1 << 50), (3, -1)):
        with pytest.raises(DamagedDataError, match="outside the array"):
            reader.bytes_at(start, length)


# ------------------------------------------------------------------------------ what is not written


@pytest.mark.parametrize("dtype", ["c8", "O", "U3", "f2", "M8[ns]", "V4"])
def test_a_type_that_the_format_lacks_is_refused(tmp_path: Path, dtype: str) -> None:
    with pytest.raises(UsageError, match="cannot be stored"):
        ArrayWriter(tmp_path / "a", dtype, (), chunk_rows=1, zstd=False)
    assert list(tmp_path.iterdir()) == []


def test_empty_and_giant_rows_are_refused(tmp_path: Path) -> None:
    for shape in ((0,), (3, 0), (1 << 14, 1 << 14)):
        with pytest.raises(UsageError, match="rows of shape"):
            ArrayWriter(tmp_path / "a", "u1", shape, chunk_rows=1, zstd=False)


@pytest.mark.parametrize(
    "rows", [np.zeros((2, 4)), np.zeros(3), np.zeros((2, 3), "c16"), np.zeros((2, 3), "U1")]
)
def test_rows_that_do_not_fit_are_refused_and_nothing_is_appended(
    tmp_path: Path, rows: np.ndarray
) -> None:
    writer = ArrayWriter(tmp_path / "a", "f8", (3,), chunk_rows=2, zstd=True)
    writer.append(np.ones((3, 3), "i4"))
    with pytest.raises(UsageError):
        writer.append(rows)
    writer.append(np.full((1, 3), 2, "f4"))
    writer.finish()
    np.testing.assert_array_equal(fast(tmp_path).read(), [[1, 1, 1]] * 3 + [[2, 2, 2]])


def test_fractions_are_never_cut_off(tmp_path: Path) -> None:
    writer = ArrayWriter(tmp_path / "a", "i8", (), chunk_rows=2, zstd=True)
    with pytest.raises(UsageError, match="does not fit into int64"):
        writer.append(np.array([1.5]))


def test_an_array_that_is_finished_or_given_up_takes_no_more(tmp_path: Path) -> None:
    finished = write(tmp_path / "a", np.arange(3))
    aborted = ArrayWriter(tmp_path / "b", "i8", (), chunk_rows=2, zstd=True)
    aborted.append(np.arange(5))
    aborted.abort()
    for writer in (finished, aborted):
        with pytest.raises(UsageError):
            writer.append(np.arange(3))
        with pytest.raises(UsageError):
            writer.finish()


# ------------------------------------------------------------------------------- other chunk orders


def shuffled(folder: Path, document: Any, *, gap: int = 0) -> None:
    """Write a shard's chunks in another order, with or without holes between them."""
    for file in shard_files(folder):
        content = file.read_bytes()
        index = index_of(file, document.chunks_per_shard)
        body, moved = b"", index.copy()
        order = [chunk for chunk in range(len(index)) if index[chunk, 0] != ABSENT]
        for chunk in reversed(order):
            start, length = (int(value) for value in index[chunk])
            body += b"?" * gap
            moved[chunk, 0] = len(body)
            body += content[start : start + length]
        file.write_bytes(with_index(body, moved))


@pytest.mark.parametrize("gap", [0, 7])
@pytest.mark.parametrize("zstd", [False, True])
def test_chunks_out_of_order_are_read_where_the_index_says(
    tmp_path: Path, gap: int, zstd: bool
) -> None:
    values = values_of("int16", (39, 3))
    write(tmp_path / "a", values, zstd=zstd, shard_bytes=96)
    shuffled(tmp_path / "a", fast(tmp_path).document, gap=gap)
    reader = fast(tmp_path)
    assert not any(reader.is_contiguous(shard) for shard in range(reader.document.shards))
    np.testing.assert_array_equal(reader.read(), values)
    foreign: Any = zarr.open_array(tmp_path / "a", mode="r")
    np.testing.assert_array_equal(foreign[...], values)
    memory = values.tobytes()
    for start in range(0, len(memory), 5):
        assert reader.bytes_at(start, min(31, len(memory) - start)) == memory[start : start + 31]


def test_what_is_contiguous(tmp_path: Path) -> None:
    write(tmp_path / "plain", np.arange(100), shard_bytes=256)
    write(tmp_path / "packed", np.arange(100), shard_bytes=256, zstd=True)
    plain, packed = fast(tmp_path, "plain"), fast(tmp_path, "packed")
    assert all(plain.is_contiguous(shard) for shard in range(plain.document.shards))
    assert not any(packed.is_contiguous(shard) for shard in range(packed.document.shards))


LAYOUTS: dict[str, dict[str, Any]] = {
    "not sharded": {"shards": None, "compressors": None},
    "gzip": {"shards": None, "compressors": zarr.codecs.GzipCodec()},
    "gzip in shards": {"compressors": zarr.codecs.GzipCodec()},
    "blosc": {"compressors": zarr.codecs.BloscCodec()},
    "big endian": {"compressors": None, "serializer": zarr.codecs.BytesCodec(endian="big")},
    "other separator": {
        "compressors": None,
        "chunk_key_encoding": {"name": "default", "separator": "."},
    },
    "version 2 keys": {
        "shards": None,
        "chunk_key_encoding": {"name": "v2", "separator": "/"},
    },
    "chunks across rows": {"chunks": (4, 2), "shards": (8, 4), "compressors": None},
    "transposed": {"filters": zarr.codecs.TransposeCodec(order=(1, 0)), "compressors": None},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_other_layout_is_refused_with_what_to_do(tmp_path: Path, layout: str) -> None:
    values = values_of("int16", (37, 4))
    options = {"chunks": (4, 4), "shards": (16, 4), **LAYOUTS[layout]}
    array: Any = zarr.create_array(tmp_path / "a", shape=values.shape, dtype="int16", **options)
    array[:] = values
    with pytest.raises(UnsupportedError, match=r"not the standard's .* with zarr\.open_array"):
        opened(tmp_path)


def test_a_standard_shard_of_another_writer_takes_the_fast_path(tmp_path: Path) -> None:
    values = values_of("uint8", (40, 3))
    array: Any = zarr.create_array(
        tmp_path / "a",
        shape=values.shape,
        dtype="uint8",
        chunks=(4, 3),
        shards=(16, 3),
        compressors=zarr.codecs.ZstdCodec(),
        config={"write_empty_chunks": True},
    )
    array[:] = values
    np.testing.assert_array_equal(fast(tmp_path).read(), values)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"shape": []}, UnsupportedError),
        ({"data_type": "complex64", "fill_value": [0, 0]}, UnsupportedError),
        ({"data_type": "string", "fill_value": ""}, UnsupportedError),
        ({"data_type": {"name": "numpy.void"}}, UnsupportedError),
        ({"data_type": ["int64"]}, UnsupportedError),
        ({"shape": [5, 0]}, UnsupportedError),
        ({"shape": "many"}, DamagedDataError),
        ({"shape": [-5]}, DamagedDataError),
        ({"shape": [True]}, DamagedDataError),
        ({"shape": [1e3]}, DamagedDataError),
        ({"codecs": []}, UnsupportedError),
        ({"codecs": "bytes"}, UnsupportedError),
        ({"codecs": [{"name": "acme"}]}, UnsupportedError),
        ({"chunk_grid": None}, UnsupportedError),
        (
            {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [0]}}},
            UnsupportedError,
        ),
        ({"chunk_key_encoding": 3}, UnsupportedError),
        ({"node_type": "group"}, DamagedDataError),
        ({"zarr_format": 2}, DamagedDataError),
    ],
    ids=str,
)
def test_a_strange_document_is_one_clear_error(
    tmp_path: Path, change: dict[str, Any], error: type[Exception]
) -> None:
    write(tmp_path / "a", np.arange(5))
    path = tmp_path / "a" / "zarr.json"
    path.write_text(json.dumps({**json.loads(path.read_bytes()), **change}))
    with pytest.raises(error, match=str(tmp_path)):
        opened(tmp_path).read()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b'{"a":NaN}'])
def test_a_document_that_is_none_is_one_clear_error(tmp_path: Path, content: bytes) -> None:
    write(tmp_path / "a", np.arange(5))
    (tmp_path / "a" / "zarr.json").write_bytes(content)
    with pytest.raises(DamagedDataError, match=r"zarr\.json"):
        opened(tmp_path)


# ------------------------------------------------------------------------------------------- damage


def test_a_missing_array_or_shard_is_named(tmp_path: Path) -> None:
    with pytest.raises(DamagedDataError, match="array is missing"):
        opened(tmp_path)
    write(tmp_path / "a", np.arange(100), shard_bytes=256)
    shutil.rmtree(tmp_path / "a" / "c" / "1", ignore_errors=True)
    (tmp_path / "a" / "c" / "1").unlink(missing_ok=True)
    for read in (
        fast(tmp_path).read,
        fast(tmp_path).check_shards,
        lambda: fast(tmp_path).rows(32, 33),
    ):
        with pytest.raises(DamagedDataError, match="a/c/1: shard is missing"):
            read()
    assert fast(tmp_path).rows(0, 32).tolist() == list(range(32))


def spoil(folder: Path, change: Any) -> None:
    """Replace the index of the first shard; its checksum is right."""
    (file, *_) = shard_files(folder)
    index = index_of(file, 4)
    body = file.read_bytes()[: -16 * 4 - 4]
    change(index)
    file.write_bytes(with_index(body, index))


def assign(entry: tuple[int, int], value: int) -> Any:
    def change(index: np.ndarray) -> None:
        index[entry] = np.uint64(value)

    return change


@pytest.mark.parametrize("zstd", [False, True])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (assign((1, 0), ABSENT), "lacks an inner chunk"),
        (assign((1, 1), ABSENT), "lacks an inner chunk"),
        (assign((1, 0), ABSENT - 7), "outside its file"),
        (assign((1, 0), 1 << 40), "outside its file"),
        (assign((1, 1), 1 << 63), "outside its file"),
        (assign((1, 0), 100_000), "outside its file"),
        (assign((0, 1), 1), "wrong length|cannot be decompressed|not zstd"),
        (assign((0, 1), 0), "wrong length|not zstd"),
    ],
)
def test_a_hostile_index_is_refused(tmp_path: Path, zstd: bool, change: Any, message: str) -> None:
    write(tmp_path / "a", values_of("int64", (16,)), shard_bytes=128, zstd=zstd)
    spoil(tmp_path / "a", change)
    with pytest.raises(DamagedDataError, match=message):
        fast(tmp_path).read()


def test_a_compressed_chunk_of_any_length_is_not_read(tmp_path: Path) -> None:
    write(tmp_path / "a", values_of("int64", (16,)), shard_bytes=128, zstd=True)
    file = shard_files(tmp_path / "a")[0]
    index = index_of(file, 4)
    index[0] = 0, 70_000
    file.write_bytes(with_index(bytes(80_000), index))
    with pytest.raises(DamagedDataError, match="longer compressed than it can be"):
        fast(tmp_path).read()


def test_chunks_that_share_bytes_cannot_multiply_a_file(tmp_path: Path) -> None:
    write(tmp_path / "a", np.zeros(16), shard_bytes=128, chunk_rows=4)
    (file,) = shard_files(tmp_path / "a")
    index = index_of(file, 4)
    index[:, 0] = 0
    file.write_bytes(with_index(bytes(32), index))
    with pytest.raises(DamagedDataError, match="overlapping chunks"):
        fast(tmp_path).read()


@pytest.mark.parametrize("zstd", [False, True])
def test_a_shard_cut_short_or_with_a_wrong_checksum(tmp_path: Path, zstd: bool) -> None:
    write(tmp_path / "a", values_of("int64", (16,)), shard_bytes=128, zstd=zstd)
    (file,) = shard_files(tmp_path / "a")
    whole = file.read_bytes()
    for length in (0, 3, 60, len(whole) - 1):
        file.write_bytes(whole[:length])
        with pytest.raises(DamagedDataError, match="shard"):
            fast(tmp_path).read()
    for position in range(len(whole) - 68, len(whole)):
        file.write_bytes(whole[:position] + bytes([whole[position] ^ 1]) + whole[position + 1 :])
        with pytest.raises(DamagedDataError, match="wrong checksum"):
            fast(tmp_path).read()


def zstd_shard(folder: Path, frame: bytes) -> None:
    """Replace the only chunk of a shard."""
    (file,) = shard_files(folder)
    index = np.array([[0, len(frame)]], "<u8")
    file.write_bytes(with_index(frame, index))


@pytest.mark.parametrize("length", [0, 1, 79, 81, 1000, 10_000_000])
def test_a_zstd_frame_of_another_length_is_refused(tmp_path: Path, length: int) -> None:
    # A decoder fills only the front of the buffer; the rest would be whatever was in memory.
    write(tmp_path / "a", np.arange(10), zstd=True, chunk_rows=100)
    zstd_shard(tmp_path / "a", bytes(Zstd().encode(bytes(length))))
    with pytest.raises(DamagedDataError, match="inner chunk 0"):
        fast(tmp_path).read()


@pytest.mark.parametrize("size", [0, 100, 300, 70_000])
def test_a_zstd_frame_may_state_its_length_in_any_way(tmp_path: Path, size: int) -> None:
    import pyarrow as pa

    values = values_of("uint8", (size + 1,))
    write(tmp_path / "a", values, zstd=True, chunk_rows=1 << 20)
    sink = pa.BufferOutputStream()
    with pa.CompressedOutputStream(sink, "zstd") as stream:  # a stream does not know its length
        stream.write(values.tobytes())
    np.testing.assert_array_equal(fast(tmp_path).read(), values)
    zstd_shard(tmp_path / "a", sink.getvalue().to_pybytes())
    np.testing.assert_array_equal(fast(tmp_path).read(), values)
    sink = pa.BufferOutputStream()
    with pa.CompressedOutputStream(sink, "zstd") as stream:
        stream.write(values.tobytes()[:-1])
    zstd_shard(tmp_path / "a", sink.getvalue().to_pybytes())
    with pytest.raises(DamagedDataError, match="inner chunk 0"):
        fast(tmp_path).read()


@pytest.mark.parametrize("frame", [b"", b"\x28\xb5\x2f\xfd", b"\x28\xb5\x2f\xfd\xff" + bytes(40)])
def test_bytes_that_are_no_zstd_are_refused(tmp_path: Path, frame: bytes) -> None:
    write(tmp_path / "a", np.arange(10), zstd=True, chunk_rows=100)
    zstd_shard(tmp_path / "a", frame)
    with pytest.raises(DamagedDataError, match="inner chunk 0"):
        fast(tmp_path).read()


def test_an_array_larger_than_the_limit_is_refused_after_its_shards_were_looked_for(
    tmp_path: Path,
) -> None:
    write(tmp_path / "a", np.arange(128), shard_bytes=256)
    path = tmp_path / "a" / "zarr.json"
    document = json.loads(path.read_bytes())
    for rows, error in ((1 << 30, DamagedDataError), (1 << 40, LimitError)):
        document["shape"] = [rows]
        path.write_text(json.dumps(document))
        with pytest.raises(error, match=r"a/c/4: shard is missing|too many chunks"):
            opened(tmp_path).read()
    document["codecs"][0]["configuration"]["chunk_shape"] = [1 << 30]
    document["chunk_grid"]["configuration"]["chunk_shape"] = [1 << 30]
    path.write_text(json.dumps(document))
    with pytest.raises(LimitError, match="a chunk of 8,589,934,592 bytes"):
        opened(tmp_path)


def test_a_document_that_is_wrong_twice_is_named_twice() -> None:
    """Documents are understood once, wherever they are; what is wrong is somewhere."""
    for where in ("here", "there"):
        with pytest.raises(DamagedDataError, match=f"^{where}: "):
            parse_array(b'{"node_type": "group"}', where)
