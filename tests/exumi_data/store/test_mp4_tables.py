"""Tables that claim more than they hold are told before FFmpeg believes them."""

import io

import pytest

from exumi_data.errors import DamagedDataError, SourceError
from exumi_data.store.mp4_tables import MAX_SAMPLES, tables_mistake
from exumi_data.store.video import MAX_PIXELS, VideoDecoder, most_pixels
from tests.exumi_data.builders import FRAMES, HEIGHT, WIDTH, clip


def box(kind: bytes, content: bytes, *, long: bool = False) -> bytes:
    if long:
        return b"\0\0\0\1" + kind + (len(content) + 16).to_bytes(8, "big") + content
    return (len(content) + 8).to_bytes(4, "big") + kind + content


def words(*values: int) -> bytes:
    return b"".join(value.to_bytes(4, "big") for value in values)


def movie(*tables: bytes, handler: bytes = b"vide", long: bool = False) -> io.BytesIO:
    inner = box(b"minf", box(b"stbl", b"".join(tables), long=long))
    media = box(b"mdia", box(b"hdlr", words(0, 0) + handler + bytes(12)) + inner)
    return io.BytesIO(box(b"ftyp", b"isom") + box(b"moov", box(b"trak", media)))


def samples(count: int, size: int = 1) -> bytes:
    return box(b"stsz", words(0, size, count))


def ticks(entries: int, duration: int) -> bytes:
    return box(b"stts", words(0, entries, 5, duration))


def test_a_sound_file_is_believed() -> None:
    assert tables_mistake(io.BytesIO(clip()[0])) is None
    with VideoDecoder(clip()[0], "here") as decoder:
        assert len(list(decoder.frames())) == FRAMES


@pytest.mark.parametrize("long", [False, True])
@pytest.mark.parametrize("kind", [b"stsz", b"stz2"])
def test_more_samples_than_are_believed(kind: bytes, long: bool) -> None:
    def table(count: int) -> bytes:
        return box(kind, words(0, 1, count))

    assert tables_mistake(movie(table(MAX_SAMPLES), long=long)) is None
    assert "claims 2,000,001 samples" in str(
        tables_mistake(movie(table(MAX_SAMPLES + 1), long=long))
    )


def test_an_hour_of_uncompressed_sound_is_believed() -> None:
    count = 48_000 * 3600
    assert tables_mistake(movie(samples(count), ticks(1, 1), handler=b"soun")) is None
    for file in (
        movie(samples(count), ticks(1, 1)),
        movie(samples(count), ticks(1, 2), handler=b"soun"),
        movie(samples(count), ticks(2, 1), handler=b"soun"),
    ):
        assert "samples" in str(tables_mistake(file))


def test_runs_of_fragments() -> None:
    def fragment(count: int) -> io.BytesIO:
        run = box(b"moof", box(b"traf", box(b"trun", words(0, count))))
        return io.BytesIO(box(b"ftyp", b"isom") + run)

    assert tables_mistake(fragment(1000)) is None
    assert "samples" in str(tables_mistake(fragment(1 << 31)))


def test_a_compressed_table_of_contents() -> None:
    file = io.BytesIO(box(b"ftyp", b"qt  ") + box(b"moov", box(b"cmov", bytes(20))))
    assert tables_mistake(file) == "its table of contents is compressed"


def test_more_boxes_than_are_believed() -> None:
    file = io.BytesIO(box(b"ftyp", b"isom") + box(b"free", b"") * 200_001)
    assert tables_mistake(file) == "it has more than 200,000 boxes"


@pytest.mark.parametrize("content", [b"", b"\0", b"RIFF    AVI ", b"\x1a\x45\xdf\xa3" * 9])
def test_what_is_no_mp4_is_not_judged(content: bytes) -> None:
    assert tables_mistake(io.BytesIO(content)) is None


@pytest.mark.parametrize("length", [0, 1, 2, 7, 0xFFFFFFFF])
def test_boxes_of_every_length_end(length: int) -> None:
    odd = length.to_bytes(4, "big") + b"trak" + bytes(40)
    assert tables_mistake(io.BytesIO(box(b"ftyp", b"isom") + odd)) is None


def claims(count: int) -> bytes:
    data = bytearray(clip()[0])
    at = data.index(b"stsz") + 8
    data[at : at + 8] = words(1, count)
    return bytes(data)


def test_a_claim_is_refused_before_memory_is_taken() -> None:
    with pytest.raises(SourceError, match="a table claims 10,000,000 samples"):
        VideoDecoder(claims(10_000_000), "here")


def test_a_frame_of_more_pixels_than_are_asked_for_is_not_decoded() -> None:
    with VideoDecoder(clip()[0], "here", pixels=100) as decoder:
        assert list(decoder.frames()) == []
        assert decoder.problem
    assert most_pixels(HEIGHT, WIDTH) == 1 << 20
    assert most_pixels(2160, 3840) == (2160 + 128) * (3840 + 128)
    assert most_pixels(65535, 65535) == MAX_PIXELS


def unknown_codec() -> bytes:
    data = clip()[0]
    at = data.index(b"esds")
    known = data.index(b"\x20\x11", at)  # MPEG-4, as the descriptor of the stream has it
    return (data[:known] + b"\xfe" + data[known + 1 :]).replace(b"mp4v", b"zzzz")


def test_a_codec_that_nobody_knows() -> None:
    with pytest.raises(SourceError, match="there is no decoder"):
        VideoDecoder(unknown_codec(), "here")


@pytest.mark.parametrize("pts", [1 << 62, -(1 << 62), 1 << 63])
def test_a_place_that_is_not_there(pts: int) -> None:
    with VideoDecoder(clip()[0], "here") as decoder:
        try:
            decoder.seek(pts)
        except DamagedDataError as error:
            assert "cannot be found" in error.what  # noqa: PT017  # whether it can depends on FFmpeg
