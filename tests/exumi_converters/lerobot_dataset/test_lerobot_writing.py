"""Episodes as a LeRobotDataset: the timeline, what stands at its ticks, and what is lost."""

import json
import tempfile
import uuid
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_converters import ConvertOptions, ExportOptions, convert, export, plan_export
from exumi_converters.lerobot_dataset import assembling, layout
from exumi_converters.lerobot_dataset.planning import LOSES
from exumi_converters.registry import find_converter, find_exporter
from exumi_converters.testing import (
    check_converter,
    check_exporter,
    check_round_trip,
    round_trip_differences,
)
from exumi_data import EpisodeWriter
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.errors import UsageError
from exumi_data.model import (
    ArrayImages,
    Clock,
    DatasetMetadata,
    EpisodeMetadata,
    Frames,
    Source,
    Task,
)
from tests.exumi_converters.whole import write_dataset

EXPORTER, CONVERTER = find_exporter("lerobot"), find_converter("lerobot")
NS = 1_000_000_000
SIDE = 32


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("whole") / "data", seconds=0.5)


def test_the_contracts(dataset: Path, tmp_path: Path) -> None:
    check_exporter(EXPORTER, dataset, tmp_path / "out")
    check_converter(CONVERTER, tmp_path / "out" / "first", tmp_path / "in")


def test_a_round_trip_loses_what_is_listed(dataset: Path, tmp_path: Path) -> None:
    lost = round_trip_differences(EXPORTER, CONVERTER, dataset, tmp_path)
    # Licences are kept where all episodes have the same.
    assert lost == set(LOSES) - {"licence"}
    announced = plan_export(dataset, tmp_path / "x", to_format="lerobot").losses
    assert {loss.facet for loss in announced} == lost


@settings(max_examples=4, deadline=None, derandomize=True)
@given(
    seconds=st.floats(0.2, 0.6),
    tactile=st.integers(1, 2),
    low_dimensional=st.booleans(),
    lossless_camera=st.booleans(),
    codec=st.sampled_from(["av1", "h264"]),
    fps=st.sampled_from(["30", "60000/1001", "15"]),
)
def test_no_round_trip_loses_more_than_is_listed(
    seconds: float,
    tactile: int,
    low_dimensional: bool,
    lossless_camera: bool,
    codec: str,
    fps: str,
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        made = write_dataset(
            Path(folder, "data"),
            1,
            seconds=seconds,
            tactile=tactile,
            low_dimensional=low_dimensional,
            lossless_camera=lossless_camera,
            audio=False,
        )
        told = ExportOptions(durable=False, settings={"codec": codec, "fps": fps})
        check_round_trip(EXPORTER, CONVERTER, made, Path(folder, "x"), export_options=told)


# -------------------------------------------------------------------------- episodes of known truth


def truth_pose(time_ns: np.ndarray) -> np.ndarray:
    """Turn once in ten seconds while moving along x; the quaternion's sign flips on the way."""
    seconds = time_ns / NS
    pose = np.zeros((len(seconds), 7))
    pose[:, 0] = 0.1 * seconds
    angle = 2 * np.pi * seconds / 10
    pose[:, 5], pose[:, 6] = np.sin(angle / 2), np.cos(angle / 2)
    pose[len(pose) // 2 :, 3:] *= -1
    return pose


def write_known(
    root: Path,
    *,
    number: int = 0,
    camera_hz: Fraction = Fraction(30),
    rate: str | None = "30/1",
    seconds: float = 1.0,
    without: slice | None = None,
    side: tuple[int, int] = (SIDE, SIDE),
    flags: dict[int, int] | None = None,
    licence: str = "CC-BY-4.0",
    width_at: float = 0.05,
    tactile: bool = False,
) -> None:
    """Write an episode whose frame i is grey of the level 40 + 2 i."""
    metadata = EpisodeMetadata(
        id=str(uuid.uuid5(uuid.NAMESPACE_URL, f"known-{number}")),
        task=Task(name="turn"),
        regime="demonstration",
        licence=licence,
        source=Source(type="simulated", tool="tests", tool_version="1"),
    )
    clock = Clock(source="hub_monotonic", stamp_point="kernel_rx")
    with EpisodeWriter(root / episode_path(metadata.id), metadata, durable=False) as writer:
        count = int(seconds * camera_hz)
        time = np.array([round(i * NS / camera_hz) for i in range(count)], np.int64) + 7_000_000
        images = ArrayImages(encoding="array", height=side[0], width=side[1], channels=3)
        fields: dict[str, Any] = {} if rate is None else {"nominal_rate": rate}
        camera = writer.add_stream("cam", kind="rgb", clock=clock, images=images, **fields)
        levels = (40 + 2 * np.arange(count)).astype(np.uint8)
        frames = np.broadcast_to(levels[:, None, None, None], (count, *side, 3)).copy()
        camera.append(time, frames)
        if tactile:
            gel = writer.add_stream("gel", kind="tactile", clock=clock, images=images)
            gel.append(time + 3_000_000, frames)
        time = np.arange(0, round(seconds * NS), 8_000_000, dtype=np.int64)
        keep = np.ones(len(time), bool)
        keep[without or slice(0, 0)] = False
        pose = writer.add_stream(
            "pose", kind="pose", clock=clock, frames=Frames(parent="world", child="tcp")
        )
        marks = np.zeros(len(time), np.uint32)
        values = truth_pose(time)
        for index, bits in (flags or {}).items():
            marks[index] = bits
            values[index, :3] = 9.0
        pose.append(time[keep], values[keep], flags=marks[keep])
        width = writer.add_stream("width", kind="width", clock=clock)
        width.append(time, np.full(len(time), width_at, np.float32))


def known(root: Path, *episodes: dict[str, Any]) -> Path:
    create_dataset(root, DatasetMetadata(name="known", licence="CC-BY-4.0"))
    for number, made in enumerate(episodes):
        write_known(root, number=number, **made)
    write_catalog(root, build_catalog(root)[0])
    return root


def write(source: Path, *, keep_going: bool = False, **told: Any) -> tuple[Any, Path]:
    options = ExportOptions(workers=1, durable=False, settings=told, keep_going=keep_going)
    target = source.parent / "written"
    return export(source, target, to_format="lerobot", options=options), target


def decoded(path: Path) -> tuple[list[int], list[float]]:
    """Return the grey level and time of every frame."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        levels = [int(np.median(f.to_ndarray(format="rgb24"))) for f in frames]
        return levels, [float(f.pts * stream.time_base) for f in frames]  # type: ignore[operator]


@pytest.mark.parametrize("codec", ["av1", "h264"])
@pytest.mark.parametrize("fps", ["30", "60000/1001", "12"])
def test_ticks_hold_the_nearest_frames_and_slerped_poses(
    tmp_path: Path, fps: str, codec: str
) -> None:
    _, target = write(known(tmp_path / "known", {}), fps=fps, codec=codec, crf="10")
    rate = Fraction(fps)
    rows = pq.read_table(target / "data/chunk-000/file-000.parquet").to_pydict()
    count = len(rows["index"])
    ticks = 7_000_000 + np.round(np.arange(count) / float(rate) * NS).astype(np.int64)
    np.testing.assert_array_equal(
        np.array(rows["timestamp"], np.float32), (np.arange(count) / float(rate)).astype(np.float32)
    )
    camera = np.round(np.arange(30) * NS / 30) + 7_000_000
    nearest = np.abs(camera[None] - ticks[:, None]).argmin(axis=1)
    levels, times = decoded(target / "videos/observation.images.cam/chunk-000/file-000.mp4")
    assert np.abs(np.array(levels) - (40 + 2 * nearest)).max() <= 1  # blended ones lie between
    np.testing.assert_allclose(times, np.arange(count) / float(rate), atol=1e-4)
    state = np.array(rows["observation.state"])
    expected = truth_pose(ticks)
    np.testing.assert_allclose(state[:, :3], expected[:, :3], atol=1e-6)
    dot = np.abs((state[:, 3:7] * expected[:, 3:]).sum(axis=1))
    np.testing.assert_allclose(dot, 1.0, atol=1e-6)
    assert ((state[1:, 3:7] * state[:-1, 3:7]).sum(axis=1) > 0).all()  # no sign flips
    np.testing.assert_allclose(state[:, 7], 0.05, atol=1e-7)
    action = np.array(rows["action"])
    np.testing.assert_array_equal(action[:-1], state[1:])
    np.testing.assert_array_equal(action[-1], state[-1])


def test_documents_say_what_lerobot_wants_to_know(tmp_path: Path) -> None:
    source = known(tmp_path / "known", {}, {"seconds": 0.5})
    report, target = write(source)
    info = json.loads((target / "meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, 45, 30)
    assert info["splits"] == {"train": "0:2"}
    assert list(info["features"]["observation.state"]["names"])[-1] == "width.width_m"
    episodes = pq.read_table(target / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert sorted(e["length"] for e in episodes) == [15, 30]
    assert [e["dataset_from_index"] for e in episodes] == [0, episodes[0]["length"]]
    assert episodes[1]["videos/observation.images.cam/file_index"] == 1
    declared = json.loads((target / "meta/exumi.json").read_text())
    assert declared["action"].startswith("observation.state of the next frame")
    assert declared["streams"]["pose"]["frames"] == {"parent": "world", "child": "tcp"}
    assert declared["licence"] == "CC-BY-4.0"
    tasks = pq.read_table(target / "meta/tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "__index_level_0__": "turn"}]
    pandas = json.loads(tasks.schema.metadata[b"pandas"])
    assert pandas["index_columns"] == ["__index_level_0__"]
    assert report.frames == 45


def test_statistics_are_those_of_the_rows_and_frames(tmp_path: Path) -> None:
    _, target = write(known(tmp_path / "known", {}, {"seconds": 0.5, "width_at": 0.03}))
    stats = json.loads((target / "meta/stats.json").read_text())
    rows = pq.read_table(target / "data/chunk-000/file-000.parquet").to_pydict()
    state = np.array(rows["observation.state"], np.float64)
    found = stats["observation.state"]
    for name, value in (
        ("min", state.min(axis=0)),
        ("max", state.max(axis=0)),
        ("mean", state.mean(axis=0)),
        ("std", state.std(axis=0)),
    ):
        np.testing.assert_allclose(found[name], value, atol=1e-9)
    assert found["count"] == [45]
    assert stats["index"]["max"] == [44]
    pixels = stats["observation.images.cam"]
    # Of one episode frames 0 to 29 are written, of the other 0 to 14.
    levels = np.concatenate([40 + 2 * np.arange(30), 40 + 2 * np.arange(15)]) / 255
    np.testing.assert_allclose(np.ravel(pixels["mean"]), levels.mean(), atol=1e-9)
    np.testing.assert_allclose(np.ravel(pixels["std"]), levels.std(), atol=1e-9)
    assert np.shape(pixels["q99"]) == (3, 1, 1)


def test_a_gap_is_refused_or_cut_and_never_filled(tmp_path: Path) -> None:
    hole = {"without": slice(40, 60)}  # 160 ms of the 125 Hz poses, beyond the 100 ms allowed
    small = {"without": slice(40, 51)}  # 96 ms
    source = known(tmp_path / "known", hole, small)
    with pytest.raises(UsageError, match=r"it has gaps: .* pose at \d frames.*-o gaps=cut"):
        write(source)
    report, _ = write(source, keep_going=True)
    assert (report.written, len(report.failed)) == (1, 1)
    plan = plan_export(
        source,
        tmp_path / "cut",
        to_format="lerobot",
        options=ExportOptions(settings={"gaps": "cut"}),
    )
    cut, whole = sorted(plan.items, key=lambda item: item.settings["frames"])
    assert whole.settings["frames"] == 30
    assert cut.settings["frames"] == 15  # from 479 ms on
    assert cut.settings["start_ns"] > 472_000_000
    assert any("1 episodes are cut at gaps" in loss.detail for loss in plan.losses)


def test_values_that_the_device_called_invalid_are_not_used(tmp_path: Path) -> None:
    _, target = write(known(tmp_path / "known", {"flags": {20: 8, 21: 8}}))
    rows = pq.read_table(target / "data/chunk-000/file-000.parquet").to_pydict()
    assert np.array(rows["observation.state"])[:, 0].max() < 0.1


def test_a_value_that_is_no_number_costs_one_episode(tmp_path: Path) -> None:
    source = known(tmp_path / "known", {}, {"width_at": float("nan")})
    report, _ = write(source, keep_going=True)
    assert report.written == 1
    assert "stream 'width': sample 0 is not finite" in report.failed[0].reason


def test_the_timeline_is_the_cameras_unless_told_otherwise(tmp_path: Path) -> None:
    source = known(tmp_path / "known", {"tactile": True})
    plan = plan_export(source, tmp_path / "x", to_format="lerobot")
    assert (plan.shared["declaration"]["timeline"], plan.shared["fps"]) == ("cam", "30/1")
    assert plan.items[0].settings["start_ns"] == 40_333_333  # the gel begins after frame 0
    told = ExportOptions(settings={"timeline": "gel", "fps": "30"})
    plan = plan_export(source, tmp_path / "x", to_format="lerobot", options=told)
    assert plan.items[0].settings["start_ns"] == 10_000_000
    # Without stored activity there is none to write.
    assert not plan.shared["features"]["activity"]


@pytest.mark.parametrize(
    ("episodes", "told", "message"),
    [
        ([{"rate": None}], {}, r"no one nominal rate: none stated \(1 episodes\).*-o fps=30"),
        ([{}, {"rate": "25/1"}], {}, r"no one nominal rate: 25/1 .*, 30/1 "),
        ([{}], {"fps": "29.97"}, "Invalid fps"),
        ([{}], {"fps": "1e9"}, "Invalid fps"),
        ([{}], {"fps": "5000"}, "at most 1000"),
        ([{}], {"timeline": "pose"}, "no image stream of that name"),
        ([{}], {"streams": "pose,grip"}, "no stream 'grip'.*cam, pose, width"),
        ([{}], {"streams": "pose"}, "no image stream gives the timeline its rate"),
        ([{"side": (31, 32)}], {}, "even sides; exumi prepare"),
        ([{}], {"codec": "vp9"}, "Invalid codec"),
        ([{}], {"codec": "h264", "crf": "60"}, "h264 knows 0 to 51"),
        ([{"seconds": 0.04}], {}, "overlap for 1 frames; at least 2"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(
    tmp_path: Path, episodes: list[dict[str, Any]], told: dict[str, Any], message: str
) -> None:
    source = known(tmp_path / "known", *episodes)
    with pytest.raises(UsageError, match=message):
        write(source, **told)
    assert [path.name for path in tmp_path.iterdir()] == ["known"]


def test_an_episode_of_another_size_is_left_out(tmp_path: Path) -> None:
    source = known(tmp_path / "known", {}, {}, {"side": (64, 32)})
    report, _ = write(source, keep_going=True)
    assert report.written == 2
    assert "its cam is rgb 64×32, that of the others rgb 32×32" in report.failed[0].reason


def test_streams_that_not_all_have_are_left_out_and_listed(tmp_path: Path) -> None:
    source = known(tmp_path / "known", {}, {"tactile": True})
    plan = plan_export(source, tmp_path / "x", to_format="lerobot")
    left = [(loss.stream, loss.detail) for loss in plan.losses if loss.facet == "streams"]
    assert left == [("gel", "not all episodes have it")]
    told = ExportOptions(settings={"streams": "cam,gel"})
    plan = plan_export(source, tmp_path / "x", to_format="lerobot", options=told)
    assert (len(plan.items), plan.refused[0].reason) == (
        1,
        "it has no stream 'gel' that can be written",
    )


def test_licences_that_differ_are_announced(tmp_path: Path) -> None:
    source = known(tmp_path / "known", {}, {"licence": "CC0-1.0"})
    plan = plan_export(source, tmp_path / "x", to_format="lerobot")
    assert "licence" in {loss.facet for loss in plan.losses}
    assert plan.shared["declaration"]["licence"] == "(CC-BY-4.0) AND (CC0-1.0)"


def test_a_rate_between_the_streams_is_counted(tmp_path: Path) -> None:
    source = known(tmp_path / "known", {})
    told = ExportOptions(settings={"fps": "60"})
    plan = plan_export(source, tmp_path / "x", to_format="lerobot", options=told)
    (time,) = [x.detail for x in plan.losses if x.facet == "time" and x.stream == "cam"]
    assert "30 samples become 59 ticks" in time
    assert "29 ticks repeat one" in time


def test_own_videos_come_back_byte_for_byte(tmp_path: Path) -> None:
    _, target = write(known(tmp_path / "known", {}))
    convert(target, tmp_path / "back", options=ConvertOptions(workers=1, durable=False))
    (episode,) = open_dataset(tmp_path / "back")
    file = target / "videos/observation.images.cam/chunk-000/file-000.mp4"
    assert episode["cam"].container(0) == file.read_bytes()
    assert episode["pose"].metadata.frames.parent == "world"  # type: ignore[attr-defined]
    assert episode.metadata.licence == "CC-BY-4.0"


def test_a_file_of_rows_that_is_full_is_followed_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(assembling, "_FILE_MB", 0)
    monkeypatch.setattr(layout, "CHUNK_FILES", 2)
    source = known(tmp_path / "known", *[{"seconds": 0.4}] * 3)
    _, target = write(source)
    names = sorted(p.relative_to(target).as_posix() for p in (target / "data").rglob("*.parquet"))
    assert names == [
        "data/chunk-000/file-000.parquet",
        "data/chunk-000/file-001.parquet",
        "data/chunk-001/file-000.parquet",
    ]
    videos = target / "videos/observation.images.cam"
    assert (videos / "chunk-001/file-000.mp4").is_file()
    report = convert(target, tmp_path / "back", options=ConvertOptions(workers=1, durable=False))
    assert (report.converted, report.failed) == (3, ())
