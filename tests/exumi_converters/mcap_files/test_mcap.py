"""MCAP, both ways: contracts, the real library reading what was written, damage, strangers."""

import json
import tempfile
from pathlib import Path
from typing import Any

import cv2
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer

from exumi_converters import ConvertOptions, ExportOptions, convert, export, plan_export
from exumi_converters.mcap_files import records
from exumi_converters.registry import find_converter, find_exporter
from exumi_converters.testing import (
    check_converter,
    check_exporter,
    check_round_trip,
    round_trip_differences,
)
from exumi_data.catalog import build_catalog, write_catalog
from exumi_data.dataset import open_dataset
from exumi_data.errors import UsageError
from exumi_data.time import parse_utc
from tests.exumi_converters.conftest import gel_frames
from tests.exumi_converters.whole import write_dataset

QUICK = ConvertOptions(workers=1, durable=False)
START = 1_780_000_000_000_000_000
EXPORTER, CONVERTER = find_exporter("mcap"), find_converter("mcap")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("whole") / "data", seconds=0.5)


def test_the_contracts(dataset: Path, tmp_path: Path) -> None:
    check_exporter(EXPORTER, dataset, tmp_path / "out")
    check_converter(CONVERTER, tmp_path / "out" / "first", tmp_path / "in")
    check_round_trip(EXPORTER, CONVERTER, dataset, tmp_path / "round")


def test_a_round_trip_loses_the_id_and_nothing_else(dataset: Path, tmp_path: Path) -> None:
    lost = round_trip_differences(EXPORTER, CONVERTER, dataset, tmp_path)
    assert lost == {"identity", "source"}


def test_the_library_and_foxgloves_schemas_read_what_was_written(
    dataset: Path, tmp_path: Path
) -> None:
    episode = open_dataset(dataset)[0]
    file = tmp_path / "one.mcap"
    export(episode.path, file, to_format="mcap", options=ExportOptions(durable=False))
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        schemas = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        assert schemas == {
            "/rgb": "foxglove.CompressedImage",
            "/tactile": "foxglove.CompressedImage",
            "/tactile/sample": "exumi.Sample",
            "/tactile/reference": "foxglove.RawImage",
            "/pose": "foxglove.FrameTransform",
            "/pose/sample": "exumi.Sample",
            "/width": "exumi.Width",
            "/force": "exumi.Wrench",
            "/taxels": "exumi.Taxels",
            "/mic": "foxglove.RawAudio",
        }
        frames = [m.decoded_message for m in reader.iter_decoded_messages("/tactile")]
        assert [frame.data for frame in frames] == [
            episode["tactile"].encoded(i) for i in range(len(episode["tactile"]))
        ]
        start = parse_utc(str(episode.metadata.start))
        stamps = [frame.timestamp.ToNanoseconds() - start for frame in frames]
        assert stamps == episode["tactile"].time.tolist()
        moves = [m.decoded_message for m in reader.iter_decoded_messages("/pose")]
        assert [(m.parent_frame_id, m.translation.x, m.rotation.w) for m in moves] == [
            ("world", pose[0], pose[6]) for pose in episode["pose"].data.tolist()
        ]
        widths = [json.loads(message.data) for _, _, message in reader.iter_messages("/width")]
        assert [w["width_m"] for w in widths] == episode["width"].data.tolist()
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert times == sorted(times)


def test_video_files_are_shown_as_jpeg_or_attached_byte_for_byte(
    make_clip: Any, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        make_clip(tmp_path / "clips" / f"{name}.mp4", 12)
    convert(tmp_path / "clips", tmp_path / "data", from_format="clips", options=QUICK)
    shown = plan_export(tmp_path / "data", tmp_path / "x", to_format="mcap")
    assert {(loss.facet, loss.stream) for loss in shown.losses} == {
        ("identity", None),
        ("source", None),
        ("frame-bytes", "tactile"),
        ("pixels", "tactile"),
    }
    lost = round_trip_differences(EXPORTER, CONVERTER, tmp_path / "data", tmp_path / "jpeg")
    assert lost == {"identity", "source", "frame-bytes", "pixels"}
    attached = ExportOptions(durable=False, settings={"video": "attach"})
    lost = round_trip_differences(
        EXPORTER, CONVERTER, tmp_path / "data", tmp_path / "attach", export_options=attached
    )
    assert lost == {"identity", "source"}


def test_intrinsics_are_foxgloves_camera_calibration(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "data", episodes=1, seconds=0.2)
    path = Path(open_dataset(root)[0].path)
    document = json.loads((path / "zarr.json").read_text())
    document["attributes"]["exumi"]["calibration"]["intrinsics/rgb"] = {
        "value": {
            "model": "fisheye",
            "width": 64,
            "height": 48,
            "fx": 30.0,
            "fy": 31.0,
            "cx": 31.5,
            "cy": 23.5,
            "distortion": [0.1, 0.2, 0.3, 0.4],
        }
    }
    (path / "zarr.json").write_text(json.dumps(document))
    write_catalog(root, build_catalog(root)[0])
    export(root, tmp_path / "one.mcap", to_format="mcap", options=ExportOptions(durable=False))
    with (tmp_path / "one.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        (message,) = reader.iter_decoded_messages("/rgb/calibration")
        said = message.decoded_message
    assert (said.distortion_model, list(said.D)) == ("kannala_brandt", [0.1, 0.2, 0.3, 0.4])
    assert list(said.K) == [30.0, 0.0, 31.5, 0.0, 31.0, 23.5, 0.0, 0.0, 1.0]


@given(
    seconds=st.sampled_from([0.1, 0.3]),
    tactile=st.integers(0, 2),
    lossless=st.booleans(),
    forces=st.booleans(),
    audio=st.booleans(),
    number=st.integers(0, 5),
)
@settings(max_examples=6, deadline=None)
def test_whatever_an_episode_holds_comes_back(
    seconds: float, tactile: int, lossless: bool, forces: bool, audio: bool, number: int
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = write_dataset(
            Path(folder, "data"),
            episodes=1,
            seconds=seconds,
            tactile=tactile,
            lossless_camera=lossless,
            low_dimensional=forces,
            audio=audio,
        )
        lost = round_trip_differences(
            EXPORTER,
            CONVERTER,
            root,
            Path(folder, "trip"),
            export_options=ExportOptions(durable=False, workers=1),
            convert_options=ConvertOptions(durable=False, workers=1),
        )
    assert number >= 0
    assert lost == {"identity", "source"}


def test_a_file_that_was_cut_gives_what_it_holds(dataset: Path, tmp_path: Path) -> None:
    export(dataset, tmp_path / "out", to_format="mcap", options=ExportOptions(durable=False))
    whole = min((tmp_path / "out").glob("*.mcap"))
    # The first chunk is whole, the rest is gone.
    with whole.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[0]
    kept = chunk.chunk_start_offset + chunk.chunk_length
    cut = tmp_path / "cut" / "cut.mcap"
    cut.parent.mkdir()
    cut.write_bytes(whole.read_bytes()[:kept])
    report = convert(cut.parent, tmp_path / "data", from_format="mcap", options=QUICK)
    assert not report.failed
    assert "truncated" in {flag.code for flag in report.flagged}
    episode = open_dataset(tmp_path / "data")[0]
    assert len(episode["pose"]) == 45
    # Within the first record there is nothing to keep.
    cut.write_bytes(whole.read_bytes()[:200])
    report = convert(cut.parent, tmp_path / "none", from_format="mcap", options=QUICK)
    assert len(report.failed) == 1
    assert "cut.mcap" in report.failed[0].reason


def foreign(path: Path) -> Path:
    """A file as another program may write it: no record of ours, other topics beside."""
    path.parent.mkdir(exist_ok=True)
    frames = [cv2.imencode(".jpg", picture)[1].tobytes() for picture in gel_frames(8)]
    with path.open("wb") as file, Writer(file) as writer:
        for index, frame in enumerate(frames):
            at = START + index * 40_000_000
            image = CompressedImage(frame_id="cam", data=frame, format="jpeg")
            image.timestamp.FromNanoseconds(at)
            writer.write_message("/camera/gel-left", image, log_time=at + 7, publish_time=at)
            pose = PoseInFrame(frame_id="map")
            pose.timestamp.FromNanoseconds(at)
            pose.pose.position.x = index / 10
            pose.pose.orientation.w = 2.0  # not of length 1
            writer.write_message("/pose", pose, log_time=at, publish_time=at)
        writer.write_message("/log", Log(message="hello"), log_time=START, publish_time=START)
        late = CompressedImage(data=b"nothing", format="webp")
        late.timestamp.FromNanoseconds(START)
        writer.write_message("/camera/gel-left", late, log_time=START, publish_time=START)
    return path


def test_a_strangers_file_gives_images_and_poses(tmp_path: Path) -> None:
    foreign(tmp_path / "in" / "theirs.mcap")
    told = ConvertOptions(
        workers=1, durable=False, settings={"tactile": "/camera/gel-left"}, task="feel"
    )
    report = convert(tmp_path / "in", tmp_path / "out", options=told)
    assert not report.failed
    episode = open_dataset(tmp_path / "out")[0]
    assert sorted(episode) == ["camera_gel_left", "pose"]
    touch = episode["camera_gel_left"]
    assert touch.kind == "tactile"
    assert len(touch) == 8
    assert touch.activity is not None
    assert str(episode.metadata.start).startswith("2026-")
    assert touch.time.tolist() == [i * 40_000_000 for i in range(8)]
    assert episode["pose"].data[3].tolist() == [0.3, 0, 0, 0, 0, 0, 1]
    codes = {note.code: note.message for note in episode.metadata.quality}
    assert "/log (foxglove.Log, protobuf)" in codes["not-converted"]
    assert "1 messages of camera_gel_left" in codes["dropped"]


def test_without_a_word_images_are_a_cameras(tmp_path: Path) -> None:
    foreign(tmp_path / "in" / "theirs.mcap")
    convert(tmp_path / "in", tmp_path / "out", from_format="mcap", options=QUICK)
    assert open_dataset(tmp_path / "out")[0]["camera_gel_left"].kind == "rgb"


def test_a_chunk_that_would_fill_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "_CHUNK_BYTES", 20_000)
    foreign(tmp_path / "in" / "bomb.mcap")
    report = convert(tmp_path / "in", tmp_path / "out", from_format="mcap", options=QUICK)
    assert "a chunk holds more than" in report.failed[0].reason


def test_what_is_no_mcap_and_what_is_empty_is_named(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "text.mcap").write_text("hello")
    with (tmp_path / "in" / "empty.mcap").open("wb") as file, Writer(file):
        pass  # its beginning and its end
    report = convert(tmp_path / "in", tmp_path / "out", from_format="mcap", options=QUICK)
    reasons = {failure.name: failure.reason for failure in report.failed}
    assert "is no MCAP file" in reasons["text.mcap"]
    assert "no message of it can be read: it is empty" in reasons["empty.mcap"]


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_damaged_bytes_are_told_and_never_a_crash(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = foreign(Path(folder) / "x.mcap")
        raw = bytearray(path.read_bytes())
        for _ in range(data.draw(st.integers(1, 4))):
            raw[data.draw(st.integers(8, len(raw) - 1))] = data.draw(st.integers(0, 255))
        path.write_bytes(bytes(raw[: data.draw(st.integers(9, len(raw)))]))
        report = convert(
            folder,
            Path(folder, "out"),
            from_format="mcap",
            options=ConvertOptions(workers=1, durable=False),
        )
    assert not [f for f in report.failed if "defect" in f.reason or "unexpected" in f.reason]


def test_several_episodes_do_not_go_into_one_file(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="2 episodes do not go into one file"):
        plan_export(dataset, tmp_path / "both.mcap", to_format="mcap")
