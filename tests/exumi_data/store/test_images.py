"""Frames: the same indexing for every encoding, decoded into the caller's buffer."""

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_data.episode import Episode, open_episode
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.store import jpeg
from exumi_data.store.pack import pack
from tests.exumi_data.builders import FRAMES, HEIGHT, WIDTH, jpegs, pictures, write_episode

ENCODINGS = {"array": "rgb", "encoded": "tactile", "video": "gopro"}


@pytest.fixture(scope="module", params=["folder", "zip"])
def episode(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Episode:
    path = write_episode(tmp_path_factory.mktemp("images") / "a.zarr")
    return open_episode(path if request.param == "folder" else pack(path))


@pytest.fixture(params=ENCODINGS)
def frames(request: pytest.FixtureRequest, episode: Episode) -> Any:
    return episode[ENCODINGS[request.param]].frames


def test_frames_are_those_that_were_written(episode: Episode) -> None:
    np.testing.assert_array_equal(episode["rgb"].frames[:], pictures())
    decoded = [jpeg_pixels(file) for file in jpegs()]
    np.testing.assert_array_equal(episode["tactile"].frames[:], decoded)
    # Video loses detail; which frame it is can still be told.
    video = episode["gopro"].frames[:].astype(int)
    distance = np.abs(video[:, None] - pictures()[None]).mean(axis=(2, 3, 4))
    assert distance.argmin(axis=1).tolist() == list(range(FRAMES))


def jpeg_pixels(file: bytes, channels: int = 3) -> np.ndarray:
    out = np.empty((HEIGHT, WIDTH, channels), np.uint8)
    jpeg.decode_into(file, out)
    return out


def test_indexing_is_that_of_an_array(frames: Any) -> None:
    whole = frames[:]
    assert frames.shape == whole.shape == (FRAMES, HEIGHT, WIDTH, 3)
    assert frames.dtype == whole.dtype == np.uint8
    assert len(frames) == FRAMES
    keys: list[Any] = [
        0,
        -1,
        np.int64(3),
        np.uint8(2),
        slice(1, 4),
        slice(None, None, -2),
        slice(10, 20),
        [0, 0, 4],
        [],
        (3, 1),
        np.array([-1, 2]),
        np.array([True, False, False, True, False]),
        np.array([], np.int64),
        range(1, 3),
    ]
    for key in keys:
        expected = whole[list(key)] if isinstance(key, tuple | range) else whole[key]
        if isinstance(key, list) and not key:
            expected = whole[:0]
        np.testing.assert_array_equal(frames[key], expected, err_msg=str(key))
    np.testing.assert_array_equal(list(frames), whole)
    np.testing.assert_array_equal(list(frames.iterate()), whole)


@pytest.mark.parametrize(
    "key", [5, -6, [0, 5], [-6], np.array([5]), np.array([True]), [0.5], [[0]], "a", [2**70]]
)
def test_what_is_no_frame(frames: Any, key: Any) -> None:
    with pytest.raises(IndexError):
        frames[key]


@settings(max_examples=40)
@given(order=st.lists(st.integers(0, FRAMES - 1), max_size=12))
def test_any_order_gives_the_same_frames(episode: Episode, order: list[int]) -> None:
    for name in ENCODINGS.values():
        frames = episode[name].frames
        np.testing.assert_array_equal(frames.read(order), frames[:][order])


def test_grey_is_the_luma_that_is_stored(episode: Episode) -> None:
    greys = {
        name: episode[name].frames.read(range(FRAMES), grey=True) for name in ("tactile", "rgb")
    }
    luma = [jpeg_pixels(file, 1) for file in jpegs()]
    np.testing.assert_array_equal(greys["tactile"], luma)
    expected = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)[..., None] for frame in pictures()]
    np.testing.assert_array_equal(greys["rgb"], expected)
    assert np.abs(greys["tactile"].astype(int) - greys["rgb"]).mean() < 2
    video = list(episode["gopro"].frames.iterate(grey=True))
    assert np.abs(np.array(video).astype(int) - greys["rgb"]).mean() < 8


def test_frames_are_decoded_into_the_callers_buffer(frames: Any) -> None:
    batch = np.full((3, 2, HEIGHT, WIDTH, 3), 9, np.uint8)
    frames.read_into([1, 4], batch[1])
    np.testing.assert_array_equal(batch[1], frames[[1, 4]])
    assert (batch[[0, 2]] == 9).all()
    frames.read_into(np.array([2, 2]), batch[0])
    np.testing.assert_array_equal(batch[0], frames[[2, 2]])


@pytest.mark.parametrize(
    "buffer",
    [
        np.empty((2, HEIGHT, WIDTH, 3), np.float32),
        np.empty((1, HEIGHT, WIDTH, 3), np.uint8),
        np.empty((2, HEIGHT, WIDTH), np.uint8),
        np.empty((2, HEIGHT, WIDTH, 4), np.uint8),
        np.empty((2, HEIGHT + 1, WIDTH, 3), np.uint8),
        np.empty((2, WIDTH, HEIGHT, 3), np.uint8),
    ],
    ids=lambda buffer: f"{buffer.shape} {buffer.dtype}",
)
def test_a_buffer_of_another_kind_is_refused(frames: Any, buffer: np.ndarray) -> None:
    with pytest.raises(UsageError, match="a buffer of"):
        frames.read_into([0, 1], buffer)


@pytest.mark.parametrize("index", [-1, 5])
def test_a_frame_outside_is_refused(frames: Any, index: int) -> None:
    with pytest.raises(IndexError, match=f"frame {index} of 5"):
        frames.read([0, index])


# --------------------------------------------------------------------------------------------- JPEG


def test_what_a_jpeg_says_of_itself() -> None:
    colour, grey = jpegs()[0], jpegs(FRAMES, 1)[0]
    assert jpeg.size_of(colour) == (HEIGHT, WIDTH, 3)
    assert jpeg.size_of(grey) == (HEIGHT, WIDTH, 1)
    assert jpeg.is_jpeg(colour)
    assert jpeg.is_jpeg(colour + bytes(20))  # cameras pad their transfers
    assert not jpeg.is_jpeg(colour[:-2])
    assert not jpeg.is_jpeg(b"")
    assert jpeg.comment(colour) is None
    commented = colour[:2] + b"\xff\xfe\x00\x08Lavc61" + colour[2:]
    assert jpeg.comment(commented) == "Lavc61"
    assert jpeg.size_of(commented) == (HEIGHT, WIDTH, 3)


@given(st.binary(max_size=60), st.integers(0, 200))
def test_bytes_that_are_no_jpeg(content: bytes, keep: int) -> None:
    for file in (content, jpegs()[0][:keep] + content):
        jpeg.comment(file)
        assert not jpeg.is_jpeg(file) or file[:2] == b"\xff\xd8"
        try:
            jpeg.decode_into(file, np.empty((HEIGHT, WIDTH, 3), np.uint8))
        except DamagedDataError:
            continue
        # What a decoder makes something of has at least a header that says this size.
        assert jpeg.size_of(file)[:2] == (HEIGHT, WIDTH)


def test_a_jpeg_with_four_colours_is_refused() -> None:
    # The marker of a frame header says four components; nothing of ours could decode them.
    file = bytearray(jpegs()[0])
    start = file.index(b"\xff\xc0")
    header = file[start : start + 19]
    header[3] += 3
    header[9] = 4
    header += b"\x04\x11\x00"
    with pytest.raises(DamagedDataError, match="not a JPEG"):
        jpeg.size_of(bytes(file[:start] + header + file[start + 19 :]))


def test_encoding_keeps_grey_grey_and_colour_close() -> None:
    for channels in (1, 3):
        frame = pictures(1, channels)[0]
        strided = np.repeat(frame, 2, axis=1)[:, ::2]
        assert jpeg.encode(strided, 95) == jpeg.encode(frame, 95)
        difference = jpeg_pixels(jpeg.encode(frame, 95), channels).astype(int) - frame
        assert np.abs(difference).mean() < 12


def test_a_jpeg_that_goes_over_the_picture_a_hundred_times() -> None:
    file = jpegs()[0]
    out = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    scan = b"\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00"
    jpeg.decode_into(file, out)
    with pytest.raises(DamagedDataError, match="more than 64 scans"):
        jpeg.decode_into(file[:-2] + scan * 64 + b"\xff\xd9", out)
