"""Files of others: many frames in one topic, clocks that disagree, pictures that lie."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawAudio_pb2 import RawAudio
from mcap_protobuf.writer import Writer

from exumi_converters import ConvertOptions, convert
from exumi_data.dataset import open_dataset
from exumi_data.episode import Episode

START = 1_780_000_000_000_000_000
MS = 1_000_000
Fill = Callable[[Any], None]


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Episode]:
    """Write a file, convert it, and return what it became."""

    def read(fill: Fill, **settings: str) -> Episode:
        with (tmp_path / "x.mcap").open("wb") as file, Writer(file) as writer:
            fill(writer)
        options = ConvertOptions(workers=1, durable=False, settings=settings)
        report = convert(tmp_path / "x.mcap", tmp_path / "out", options=options)
        assert not report.failed, report.failed
        return open_dataset(tmp_path / "out")[0]

    return read


def put(writer: Any, topic: str, message: Any, stamp_ns: int, log_ns: int | None = None) -> None:
    message.timestamp.FromNanoseconds(stamp_ns)
    at = stamp_ns if log_ns is None else log_ns
    writer.write_message(topic, message, log_time=at, publish_time=at)


def transform(child: str, x: float = 0.0) -> FrameTransform:
    message = FrameTransform(parent_frame_id="world", child_frame_id=child)
    message.rotation.w, message.translation.x = 1.0, x
    return message


def jpeg(value: int, side: int = 32) -> CompressedImage:
    data = cv2.imencode(".jpg", np.full((side, side, 3), value, np.uint8))[1].tobytes()
    return CompressedImage(data=data, format="jpeg")


def notes(episode: Episode) -> dict[str, str]:
    return {note.code: note.message for note in episode.metadata.quality}


def test_each_frame_of_a_topic_of_transforms_is_a_stream(read: Any) -> None:
    def fill(writer: Any) -> None:
        for i in range(4):
            put(writer, "/tf", transform("tcp", i), START + i * MS)
            put(writer, "/tf", transform("camera", 10 + i), START + i * MS)

    episode = read(fill)
    assert {n: s.metadata.frames.child for n, s in episode.streams.items()} == {
        "tf": "tcp",
        "tf_camera": "camera",
    }
    assert episode["tf"].data[:, 0].tolist() == [0, 1, 2, 3]
    assert episode["tf_camera"].data[:, 0].tolist() == [10, 11, 12, 13]
    assert episode["tf"].time.tolist() == [i * MS for i in range(4)]


def test_more_frames_than_streams_are_left_out_and_said(read: Any) -> None:
    def fill(writer: Any) -> None:
        for i in range(80):
            put(writer, "/tf", transform(f"f{i}"), START + i * MS)

    episode = read(fill)
    assert len(episode.streams) == 64
    assert "16 messages of /tf were left out: more than 64" in notes(episode)["dropped"]


def test_a_clock_of_its_own_is_put_where_it_was_logged(read: Any) -> None:
    def fill(writer: Any) -> None:
        for i in range(4):
            at = START + i * 10 * MS
            put(writer, "/rgb", jpeg(50), at, at + 3 * MS)
            put(writer, "/pose", transform("tcp"), 5_000_000_000 + i * 10 * MS, at + 5 * MS)

    episode = read(fill)
    assert episode["rgb"].time.tolist() == [i * 10 * MS for i in range(4)]
    assert episode["pose"].time.tolist() == [2 * MS + i * 10 * MS for i in range(4)]
    assert "stamps of pose are more than a day" in notes(episode)["other-clock"]


def test_stamps_from_when_a_device_was_switched_on_count_from_the_first(read: Any) -> None:
    def fill(writer: Any) -> None:
        for i in range(3):
            put(writer, "/pose", transform("tcp"), 5_000_000_000 + i * MS)

    episode = read(fill)
    assert episode["pose"].time.tolist() == [0, MS, 2 * MS]
    assert episode.metadata.start is None


def test_times_that_go_back_or_wild_are_left_out(read: Any) -> None:
    stamps = [0, 10, 20, 15, 20, 2**62 // MS, 30]

    def fill(writer: Any) -> None:
        for stamp in stamps:
            put(writer, "/pose", transform("tcp", stamp), START + stamp * MS, START)
        strange = transform("tcp")
        strange.timestamp.seconds = 2**62
        writer.write_message("/pose", strange, log_time=2**64 - 1, publish_time=0)

    episode = read(fill)
    # Two of one time are kept, the second a nanosecond later.
    assert episode["pose"].time.tolist() == [0, 10 * MS, 20 * MS, 20 * MS + 1, 30 * MS]
    said = notes(episode)["dropped"]
    assert said == (
        "3 messages of pose were left out: a time before that of the one before; "
        "a time more than a day from the first; a time that no clock shows"
    )


def png(height: int, width: int) -> bytes:
    """Return a PNG whose header claims a size."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    real = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes()
    return real[:8] + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head)) + real[33:]


def test_pictures_that_lie_or_are_cut_are_left_out(read: Any) -> None:
    bad = [
        jpeg(9).data[:-20],  # first: it must not make the stream one of pixels
        png(60_000, 60_000),
        b"",
        b"RIFF\x00\x00\x00\x00WEBPVP8X" + b"\xff" * 30,
        b"BM" + bytes(60),
    ]

    def fill(writer: Any) -> None:
        for i, data in enumerate(bad):
            put(writer, "/rgb", CompressedImage(data=data, format="jpeg"), START + i * MS)
        for i in range(3):
            put(writer, "/rgb", jpeg(40 + i), START + (10 + i) * MS)
        put(writer, "/rgb", jpeg(40, side=48), START + 20 * MS)

    episode = read(fill)
    assert episode["rgb"].metadata.images.encoding == "encoded"
    assert len(episode["rgb"]) == 3
    said = notes(episode)["dropped"]
    assert said.startswith("6 messages of rgb were left out")
    assert "claims 60000x60000 pixels" in said


@pytest.mark.parametrize("ending", [".png", ".webp"])
def test_png_and_webp_become_pixels(read: Any, ending: str) -> None:
    truth = np.random.default_rng(1).integers(0, 255, (3, 20, 30, 3)).astype(np.uint8)
    how = [cv2.IMWRITE_WEBP_QUALITY, 101] if ending == ".webp" else []

    def fill(writer: Any) -> None:
        for i, picture in enumerate(truth):
            data = cv2.imencode(ending, picture[..., ::-1], how)[1].tobytes()
            put(writer, "/rgb", CompressedImage(data=data, format=ending[1:]), START + i * MS)

    np.testing.assert_array_equal(read(fill)["rgb"].frames[:], truth)


def test_tactile_pictures_are_those_that_were_taken(read: Any) -> None:
    def fill(writer: Any) -> None:
        put(writer, "/gel", CompressedImage(data=b"nothing"), START)
        for i in range(12):
            put(writer, "/gel", jpeg(40 + i), START + (1 + i) * MS)

    episode = read(fill, tactile="/gel")
    assert episode["gel"].kind == "tactile"
    assert len(episode["gel"]) == 12
    assert episode["gel"].activity is not None
    assert episode["gel"].reference.shape == (32, 32, 3)


def test_sound_that_changes_is_left_out(read: Any) -> None:
    def fill(writer: Any) -> None:
        for i, (rate, channels) in enumerate([(0, 1), (8000, 1), (8000, 2), (16000, 1), (8000, 1)]):
            block = RawAudio(
                data=bytes(160), format="pcm-s16", sample_rate=rate, number_of_channels=channels
            )
            put(writer, "/mic", block, START + i * 10 * MS)

    episode = read(fill)
    assert len(episode["mic"]) == 2
    assert notes(episode)["dropped"].startswith("3 messages of mic were left out")


def test_topics_of_any_name_become_streams(read: Any) -> None:
    topics = ["/" + "x" * 300, "/接触/カメラ", "/1", "///", "/a/b", "/a_b"]

    def fill(writer: Any) -> None:
        for topic in topics:
            put(writer, topic, jpeg(40), START)

    episode = read(fill)
    assert sorted(episode) == ["a_b", "a_b_2", "topic", "topic_1", "topic_2", "x" * 56]
