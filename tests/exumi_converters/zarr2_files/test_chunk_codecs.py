"""Chunks decode to what was stored; none makes an object, or more than its size."""

import bz2
import gzip
import lzma
import pickle
import struct
import tracemalloc
import zlib
from typing import Any

import imagecodecs
import numcodecs
import numpy as np
import pytest
from imagecodecs.numcodecs import register_codecs

from exumi_converters.zarr2_files.chunk_codecs import check_codec, check_filters, decode_chunk
from exumi_data.errors import ExumiError, SourceError, UnsupportedError

register_codecs(verbose=False)

FRAME = np.random.default_rng(0).integers(0, 255, (1, 24, 20, 3), np.uint8)


@pytest.mark.parametrize(
    "config",
    [
        None,
        {"id": "zlib", "level": 1},
        {"id": "gzip", "level": 1},
        {"id": "bz2", "level": 1},
        {"id": "lzma", "format": 1, "check": -1, "preset": None, "filters": None},
        {"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 1, "blocksize": 0},
        {"id": "lz4", "acceleration": 1},
        {"id": "zstd", "level": 1},
        {"id": "imagecodecs_jpegxl", "lossless": True},
        {"id": "imagecodecs_jpeg2k"},
        {"id": "imagecodecs_png"},
        {"id": "imagecodecs_lz4"},
        {"id": "imagecodecs_jpegls"},
        {"id": "imagecodecs_zstd"},
        {"id": "imagecodecs_deflate"},
    ],
    ids=str,
)
@pytest.mark.parametrize("channels", [1, 3])
def test_what_a_codec_encoded_is_decoded(config: dict[str, Any] | None, channels: int) -> None:
    frame = np.ascontiguousarray(FRAME[..., :channels])
    data = frame.tobytes() if config is None else bytes(numcodecs.get_codec(config).encode(frame))
    out = np.empty_like(frame)
    decode_chunk(data, out, config, None, "here")
    np.testing.assert_array_equal(out, frame)


def test_parameters_of_other_versions_do_not_matter() -> None:
    data = bytes(imagecodecs.jpegxl_encode(FRAME[0], lossless=True))
    config = {"id": "imagecodecs_jpegxl", "level": 99, "photometric": None, "from_tomorrow": 1}
    check_codec(config, "here")
    out = np.empty_like(FRAME)
    decode_chunk(data, out, config, None, "here")
    np.testing.assert_array_equal(out, FRAME)


def test_filters_that_keep_the_size_are_undone() -> None:
    values = np.arange(40, dtype="<i4")
    filters: list[Any] = [{"id": "delta", "dtype": "<i4"}, {"id": "shuffle", "elementsize": 4}]
    data: Any = values
    for item in filters:
        data = numcodecs.get_codec(dict(item)).encode(data)
    check_filters(filters, "here")
    out = np.empty_like(values)
    decode_chunk(bytes(numcodecs.Zlib().encode(data)), out, {"id": "zlib"}, filters, "here")
    np.testing.assert_array_equal(out, values)


@pytest.mark.parametrize("name", ["pickle", "json2", "vlen-utf8", "categorize", "msgpack2"])
def test_objects_are_refused_with_a_way_out(name: str) -> None:
    with pytest.raises(UnsupportedError, match=r"objects.*Write the array again"):
        check_codec({"id": name}, "here")
    with pytest.raises(UnsupportedError, match="objects"):
        check_filters([{"id": name}], "here")


@pytest.mark.parametrize("config", [{"id": "nonsense"}, {"id": "imagecodecs_nonsense"}, {}])
def test_an_unknown_codec_is_refused(config: dict[str, Any]) -> None:
    with pytest.raises(UnsupportedError, match=r"Read are|Install"):
        check_codec(config, "here")


@pytest.mark.parametrize(
    "item", [{"id": "packbits"}, {"id": "delta", "dtype": "<i4", "astype": "<i8"}]
)
def test_a_filter_that_grows_is_refused(item: dict[str, Any]) -> None:
    with pytest.raises(UnsupportedError, match="filter"):
        check_filters([item], "here")


BOMB = b"\0" * 20_000_000
SMALL = np.empty((1, 8, 8, 3), np.uint8)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("zlib", zlib.compress(BOMB)),
        ("gzip", gzip.compress(BOMB, 1)),
        ("bz2", bz2.compress(BOMB)),
        ("lzma", lzma.compress(BOMB, preset=0)),
        ("zstd", bytes(numcodecs.Zstd().encode(BOMB))),
        ("blosc", bytes(numcodecs.Blosc("zstd").encode(BOMB))),
        ("lz4", bytes(numcodecs.LZ4().encode(BOMB))),
        ("imagecodecs_zstd", bytes(imagecodecs.zstd_encode(BOMB))),
        (
            "imagecodecs_jpegxl",
            imagecodecs.jpegxl_encode(np.zeros((2600, 2600), np.uint8), effort=1),
        ),
        ("imagecodecs_png", imagecodecs.png_encode(np.zeros((2600, 2600, 3), np.uint8), level=1)),
        ("imagecodecs_jpeg", imagecodecs.jpeg_encode(np.zeros((2600, 2600, 3), np.uint8))),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_bomb_takes_no_memory(name: str, data: bytes) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(SourceError):
            decode_chunk(data, SMALL, {"id": name}, None, "here")
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("config", "encode"),
    [
        ({"id": "zstd"}, numcodecs.Zstd().encode),
        ({"id": "lz4"}, numcodecs.LZ4().encode),
        ({"id": "blosc"}, numcodecs.Blosc("lz4").encode),
        ({"id": "zlib"}, zlib.compress),
        ({"id": "imagecodecs_zstd"}, imagecodecs.zstd_encode),
        ({"id": "imagecodecs_lz4"}, imagecodecs.lz4_encode),
        ({"id": "imagecodecs_blosc"}, imagecodecs.blosc_encode),
        ({"id": "imagecodecs_zlib"}, imagecodecs.zlib_encode),
    ],
    ids=lambda value: value["id"] if isinstance(value, dict) else "",
)
@pytest.mark.parametrize("size", [1, 100, SMALL.nbytes - 1, SMALL.nbytes + 1, 70_000])
def test_no_byte_of_a_chunk_is_made_up(config: dict[str, Any], encode: Any, size: int) -> None:
    with pytest.raises(SourceError):
        decode_chunk(bytes(encode(b"\1" * size)), np.empty_like(SMALL), config, None, "here")


@pytest.mark.parametrize("size", [1, 200, 256, 300, 65_791, 65_792, 70_000])
def test_zstd_of_any_size_is_read(size: int) -> None:
    out = np.empty(size, np.uint8)
    values = np.random.default_rng(0).integers(0, 9, size).astype(np.uint8)
    decode_chunk(bytes(numcodecs.Zstd().encode(values)), out, {"id": "zstd"}, None, "here")
    np.testing.assert_array_equal(out, values)


def test_lzma_that_wants_gigabytes_is_refused() -> None:
    data = bytearray(lzma.compress(bytes(SMALL.nbytes), lzma.FORMAT_ALONE, preset=0))
    data[1:5] = struct.pack("<L", 1 << 31)  # of the dictionary
    with pytest.raises(SourceError, match="Memory usage limit"):
        decode_chunk(bytes(data), SMALL, {"id": "lzma"}, None, "here")


def test_a_zstd_frame_of_unknown_size_is_refused() -> None:
    frame = bytes([0x28, 0xB5, 0x2F, 0xFD, 0x00, 0x58, 0x01, 0x00, 0x00])
    with pytest.raises(SourceError, match="does not say"):
        decode_chunk(frame, SMALL, {"id": "zstd"}, None, "here")


@pytest.mark.parametrize("name", ["imagecodecs_jpegxl", "blosc", "zstd", "lz4", "zlib"])
def test_garbage_is_an_error(name: str) -> None:
    data = np.random.default_rng(1).bytes(300)
    with pytest.raises(ExumiError):
        decode_chunk(data, np.empty_like(FRAME), {"id": name}, None, "here")


def test_a_garbled_image_is_never_taken_for_the_picture() -> None:
    refused = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        data = bytearray(imagecodecs.jpegxl_encode(FRAME[0], lossless=True))
        data[12 + seed :] = rng.bytes(len(data) - 12 - seed)
        out = np.empty_like(FRAME)
        try:
            decode_chunk(bytes(data), out, {"id": "imagecodecs_jpegxl"}, None, "here")
        except SourceError:
            refused += 1
        else:
            assert not np.array_equal(out, FRAME)
    assert refused > 0


def test_a_pickle_is_not_run(tmp_path: Any) -> None:
    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return (tmp_path.joinpath("run").touch, ())

    with pytest.raises(ExumiError):
        decode_chunk(pickle.dumps(Evil()), SMALL, None, [{"id": "pickle"}], "here")
    assert not (tmp_path / "run").exists()
