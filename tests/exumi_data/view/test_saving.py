"""A view of an episode that has everything, read back and compared with the episode."""

import dataclasses
import functools
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from exumi_data.dataset import open_dataset
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import UsageError
from exumi_data.model import Annotations, CalibrationItem, Gap
from exumi_data.model.description import Segment
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.shards import ArrayWriter
from exumi_data.tactile import ActivityMeter, representation, to_grey
from exumi_data.time import parse_utc
from exumi_data.view.names import ViewOptions
from exumi_data.view.program import run_rerun
from exumi_data.view.saving import save_view
from exumi_data.view.tactile import DIFFERENCE_COLOURS
from tests.exumi_data.builders import (
    CLOCK,
    FRAMES,
    HEIGHT,
    WIDTH,
    edit_json,
    edit_metadata,
    encoded_images,
    jpegs,
    metadata,
    pictures,
    times,
    write_dataset,
    write_episode,
)
from tests.exumi_data.view.reading import Recording, read_view

GROUND, CONVEX, CONCAVE = np.array([[13, 17, 23], [255, 183, 77], [79, 156, 255]], np.float32)
START = "2026-03-01T10:20:30.000000007Z"
TIMES = times().tolist()


@dataclasses.dataclass
class Everything:
    """An episode with everything, and its view."""

    episode: Episode
    path: Path
    file: Path
    shown: Recording


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Everything:
    folder = tmp_path_factory.mktemp("everything")
    segments = [
        Segment(name="reach", start_ns=0, end_ns=100),
        Segment(name="touch", start_ns=100, end_ns=200),
        Segment(name="whole", start_ns=0, end_ns=200),
    ]
    path = write_episode(
        folder / "one.zarr",
        start=START,
        annotations=Annotations(part_id="lid", segments=segments),
        calibration={
            "encoder": CalibrationItem(value={"m_per_count": 0.015, "zero_m": 0.02}),
            "intrinsics/rgb": CalibrationItem(
                value={
                    "model": "pinhole",
                    "width": WIDTH,
                    "height": HEIGHT,
                    "fx": 20.0,
                    "fy": 21.0,
                    "cx": 15.5,
                    "cy": 11.5,
                }
            ),
            "T_tcp_rgb": CalibrationItem(
                value=[[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]]
            ),
        },
    )
    file = folder / "one.rrd"
    episode = open_episode(path)
    report = save_view(episode, file)
    assert not report.is_damaged
    assert report.bytes == file.stat().st_size
    (shown,) = read_view(file).values()
    return Everything(episode, path, file, shown)


def scalars(recording: Recording, entity: str) -> tuple[list[int], list[float]]:
    column = recording.column(entity, "Scalars:scalars")
    return column.time, [value for (value,) in column.values]


def test_rerun_finds_the_file_sound_and_complete(everything: Everything) -> None:
    assert run_rerun("rrd", "verify", str(everything.file))[0] == 0
    reader = RrdReader(everything.file)
    assert [entry.recording_id for entry in reader.recordings()] == [everything.episode.id]
    assert len(reader.blueprints()) == 1
    assert everything.shown.application == "exUMI: press"
    assert everything.shown.name == f"lid · press · {everything.episode.id}"


def test_jpeg_files_are_those_of_the_camera(everything: Everything) -> None:
    column = everything.shown.column("/tactile/tactile/image", "EncodedImage:blob")
    assert column.blobs == list(jpegs())
    assert column.time == TIMES
    assert everything.shown.fixed["/tactile/tactile/image", "EncodedImage:media_type"] == [
        "image/jpeg"
    ]


def test_both_timelines_are_exact(everything: Everything) -> None:
    column = everything.shown.column("/tactile/tactile/image", "EncodedImage:blob")
    assert column.utc == [parse_utc(START) + time for time in TIMES]


def test_arrays_are_shown_pixel_by_pixel_where_the_camera_sits(everything: Everything) -> None:
    path = "/space/world/pose/rgb"
    column = everything.shown.column(path, "Image:buffer")
    assert column.time == TIMES
    shape = (HEIGHT, WIDTH, 3)
    shown = [np.frombuffer(blob or b"", np.uint8).reshape(shape) for blob in column.blobs]
    np.testing.assert_array_equal(shown, pictures())
    (layout,) = everything.shown.fixed[path, "Image:format"]
    assert (layout["width"], layout["height"]) == (WIDTH, HEIGHT)
    # In Rerun whole numbers are the edges of pixels; matrices are stored by column.
    (sees,) = everything.shown.fixed[path, "Pinhole:image_from_camera"]
    np.testing.assert_allclose(sees, [20, 0, 0, 0, 21, 0, 16, 12, 1])
    (where,) = everything.shown.fixed[path, "Transform3D:translation"]
    np.testing.assert_allclose(where, [0.1, 0.2, 0.3], atol=1e-7)
    (turned,) = everything.shown.fixed[path, "Transform3D:mat3x3"]
    np.testing.assert_allclose(np.reshape(turned, (3, 3)).T, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_video_that_rerun_does_not_decode_is_shown_as_its_frames(everything: Everything) -> None:
    column = everything.shown.column("/camera/gopro", "EncodedImage:blob")
    assert column.time == everything.episode["gopro"].time.tolist()
    for blob, frame in zip(column.blobs, everything.episode["gopro"].frames, strict=True):
        out = np.empty_like(frame)
        jpeg.decode_into(blob or b"", out)
        assert np.abs(out.astype(int) - frame).mean() < 12  # colours at half the resolution


def test_differences_are_the_representation(everything: Everything) -> None:
    column = everything.shown.column("/tactile/tactile/difference", "EncodedImage:blob")
    assert column.time == TIMES
    reference = to_grey(pictures()[0])
    apart = swapped = 0.0
    for blob, file in zip(column.blobs, jpegs(), strict=True):
        grey = np.empty((HEIGHT, WIDTH, 1), np.uint8)
        shown = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        jpeg.decode_into(file, grey)
        jpeg.decode_into(blob or b"", shown)
        _, convex, concave = representation(grey[..., 0], reference)[..., None]
        expected = GROUND + convex * (CONVEX - GROUND) + concave * (CONCAVE - GROUND)
        other = GROUND + concave * (CONVEX - GROUND) + convex * (CONCAVE - GROUND)
        apart += float(np.abs(shown - expected).mean()) / FRAMES
        swapped += float(np.abs(shown - other).mean()) / FRAMES
    # Of 255: what JPEG costs, and what a mistake would.
    assert apart < 6
    assert swapped > 40


def test_colours_of_differences() -> None:
    assert DIFFERENCE_COLOURS.shape == (511, 3)
    assert DIFFERENCE_COLOURS[255].tolist() == [13, 17, 23]
    assert (
        DIFFERENCE_COLOURS[-1].tolist() == DIFFERENCE_COLOURS[255 + 37].tolist() == [255, 183, 77]
    )
    assert DIFFERENCE_COLOURS[0].tolist() == DIFFERENCE_COLOURS[255 - 37].tolist() == [79, 156, 255]
    assert DIFFERENCE_COLOURS[255 + 36].tolist() != [255, 183, 77]


def test_activity_with_its_threshold_and_salient_frames(everything: Everything) -> None:
    stored = everything.episode["tactile"].activity
    assert stored is not None
    assert scalars(everything.shown, "/activity/tactile") == (TIMES, stored.tolist())
    ends = [TIMES[0], TIMES[-1]]
    assert scalars(everything.shown, "/activity/active_above/0_001") == (ends, [1e-3, 1e-3])
    salient = scalars(everything.shown, "/activity/salient/tactile")
    assert salient == ([TIMES[1], TIMES[3]], [float(stored[1]), float(stored[3])])


def test_poses_and_what_moves_with_them(everything: Everything) -> None:
    poses = everything.episode["pose"].data
    moved = everything.shown.column("/space/world/pose", "Transform3D:translation")
    turned = everything.shown.column("/space/world/pose", "Transform3D:quaternion")
    assert moved.time == turned.time == TIMES
    np.testing.assert_allclose([v for (v,) in moved.values], poses[:, :3], atol=1e-7)
    np.testing.assert_allclose([v for (v,) in turned.values], poses[:, 3:], atol=1e-7)
    (way,) = everything.shown.fixed["/space/world/paths/pose", "LineStrips3D:strips"]
    np.testing.assert_allclose(way, poses[:, :3], atol=1e-7)
    # Rerun's letters for right, forward, up: x, y and z of a right-handed frame, z up.
    (axes,) = everything.shown.fixed["/space/world", "ViewCoordinates:xyz"]
    assert axes == [3, 5, 1]
    opening = everything.shown.column("/space/world/pose/opening", "Ellipsoids3D:half_sizes")
    half = np.repeat(everything.episode["width"].data[:, None] / 2, 3, axis=1)
    np.testing.assert_allclose([v for (v,) in opening.values], half, atol=1e-7)


def test_numbers(everything: Everything) -> None:
    width = everything.episode["width"].data.astype(np.float64).tolist()
    assert scalars(everything.shown, "/width/width") == (TIMES, width)
    force = everything.episode["force"].data.astype(np.float64)
    for column, name in enumerate(("fx", "fy", "fz")):
        assert scalars(everything.shown, f"/force/force/{name}") == (
            TIMES,
            force[:, column].tolist(),
        )
    assert scalars(everything.shown, "/other/smell/0") == (TIMES, list(range(FRAMES)))


def test_taxels_are_a_heat_map_without_dead_cells(everything: Everything) -> None:
    column = everything.shown.column("/taxels/taxels", "DepthImage:buffer")
    assert column.time == TIMES
    shown = np.array(
        [np.frombuffer(blob or b"", np.float32).reshape(2, 3) for blob in column.blobs]
    )
    expected = everything.episode["taxels"].data.astype(np.float32)
    assert (shown[:, 0, 2] == 0).all()
    valid = np.ones((2, 3), np.bool_)
    valid[0, 2] = False
    np.testing.assert_array_equal(shown[:, valid], expected[:, valid])
    crosses = np.array(everything.shown.fixed["/taxels/taxels/dead", "LineStrips2D:strips"])
    assert len(crosses) == 2
    np.testing.assert_allclose(crosses.reshape(-1, 2).mean(axis=0), [2.5, 0.5], atol=1e-6)
    (limits,) = everything.shown.fixed["/taxels/taxels", "DepthImage:depth_range"]
    assert limits == [0.0, float(expected[:, valid].max())]


def test_segments_are_lanes_and_events(everything: Everything) -> None:
    column = everything.shown.column("/events/segments", "TextLog:text")
    lines = list(zip(column.time, [text for (text,) in column.values], strict=True))
    assert sorted(lines) == [
        (0, "reach begins"),
        (0, "whole begins"),
        (100, "reach ends"),
        (100, "touch begins"),
        (200, "touch ends"),
        (200, "whole ends"),
    ]
    lanes = [everything.shown.column(f"/segments/{n}", "StateChange:state") for n in range(2)]
    assert [(lane.time, [state for (state,) in lane.values]) for lane in lanes] == [
        ([0, 100, 200], ["reach", "touch", ""]),
        ([0, 200], ["whole", ""]),
    ]


def test_what_is_said_of_an_episode(everything: Everything) -> None:
    (text,) = everything.shown.fixed["/about", "TextDocument:text"]
    assert text.startswith("# press\n")
    assert "**part** lid" in text


def test_the_same_episode_gives_the_same_recording(everything: Everything, tmp_path: Path) -> None:
    again = tmp_path / "again.rrd"
    save_view(everything.episode, again)
    assert read_view(again) == read_view(everything.file)
    code, printed = run_rerun("rrd", "compare", "--unordered", str(again), str(everything.file))
    assert code == 0, printed
    with pytest.raises(KeyError):
        everything.shown.column("/tactile/tactile/image", "log_time")


def test_a_few_streams(everything: Everything, tmp_path: Path) -> None:
    file = tmp_path / "few.rrd"
    report = save_view(everything.episode, file, options=ViewOptions(streams=("width", "rgb")))
    assert report.episodes[0].samples == {"rgb": FRAMES, "width": FRAMES}
    (shown,) = read_view(file).values()
    assert {entity for entity in shown.entities if entity.startswith("/tactile")} == set()
    assert "/width/width" in shown.entities
    with pytest.raises(UsageError, match=r"no stream 'wdth'.*There are: .*width"):
        save_view(everything.episode, tmp_path / "x.rrd", options=ViewOptions(streams=("wdth",)))
    assert [path.name for path in tmp_path.iterdir()] == ["few.rrd"]


def test_a_dataset_is_one_recording_an_episode(tmp_path: Path) -> None:
    dataset = open_dataset(write_dataset(tmp_path / "set", 3))
    seen: list[tuple[int, int, str]] = []
    report = save_view(
        dataset,
        tmp_path / "set.rrd",
        max_episodes=2,
        on_progress=lambda *now: seen.append(now),
    )
    found = read_view(tmp_path / "set.rrd")
    assert [episode.id for episode in report.episodes] == dataset.ids[:2]
    assert set(found) == set(dataset.ids[:2])
    assert {recording.application for recording in found.values()} == {"exUMI: tests"}
    assert report.available == 3
    assert len(RrdReader(tmp_path / "set.rrd").blueprints()) == 1
    samples = 2 * 2 * FRAMES
    assert seen[-1][:2] == (samples, samples)
    assert dataset.ids[0] in seen[0][2]


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_no_thread_of_a_recording_stays(everything: Everything, tmp_path: Path) -> None:
    counts = []
    for number in range(3):
        save_view(everything.episode, tmp_path / f"{number}.rrd")
        counts.append(len(list(Path("/proc/self/task").iterdir())))
    assert counts[0] == counts[2]


def test_a_damaged_frame_is_missing_and_reported(tmp_path: Path) -> None:
    path = write_tactile(tmp_path / "one.zarr")
    shard = next((path / "streams/tactile/data/c").rglob("*"))
    content = bytearray(shard.read_bytes())
    at = content.find(jpegs()[2])
    content[at + 40] ^= 0xFF
    shard.write_bytes(content)
    with open_episode(path) as episode:
        report = save_view(episode, tmp_path / "one.rrd")
    (fault,) = report.episodes[0].faults
    assert report.is_damaged
    assert (fault.stream, fault.count) == ("tactile", 1)
    (shown,) = read_view(tmp_path / "one.rrd").values()
    for entity in ("image", "difference"):
        column = shown.column(f"/tactile/tactile/{entity}", "EncodedImage:blob")
        assert column.time == TIMES
        assert [blob is None for blob in column.blobs] == [False, False, True, False, False]
    events = shown.column("/events/tactile", "TextLog:text")
    missing = [n for n, (text,) in enumerate(events.values) if "frame 2 is missing" in text]
    assert [events.time[n] for n in missing] == [TIMES[2]]


def write_tactile(path: Path, **clock: object) -> Path:
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        tactile = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=encoded_images())
        tactile.append(times(), jpegs(), flags=np.array([0, 8, 8, 0, 4], np.uint32))
        tactile.set_reference(pictures()[0], method="captured", contact_free=True)
    return path


def test_activity_that_is_not_stored_is_measured(tmp_path: Path) -> None:
    with open_episode(write_tactile(tmp_path / "one.zarr")) as episode:
        report = save_view(episode, tmp_path / "one.rrd")
        (shown,) = read_view(tmp_path / "one.rrd").values()
        meter = ActivityMeter(pictures()[0])
        measured = [
            meter.measure(frame[..., 0]) for frame in episode["tactile"].frames.iterate(grey=True)
        ]
    assert scalars(shown, "/activity/tactile") == (TIMES, measured)
    assert report.episodes[0].notes == (
        "tactile: activity is not stored; it was measured for the view",
    )
    events = shown.column("/events/tactile", "TextLog:text")
    assert [text for (text,) in events.values] == [
        "tactile: invalid, samples 1 to 2",
        "tactile: gap_before, sample 4",
    ]


def test_a_broken_stream_does_not_take_the_others_with_it(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "one.zarr")
    for shard in (path / "streams/pose/data/c").rglob("*"):
        if shard.is_file():
            shard.unlink()
    with open_episode(path) as episode:
        report = save_view(episode, tmp_path / "one.rrd")
    (fault,) = report.episodes[0].faults
    assert (fault.stream, fault.count) == ("pose", 0)
    (shown,) = read_view(tmp_path / "one.rrd").values()
    assert "/width/width" in shown.entities
    assert "cannot be read" in shown.column("/events/pose", "TextLog:text").values[0][0]


@pytest.mark.parametrize("array", ["pose/data", "pose/time", "tactile/data", "tactile/reference"])
@pytest.mark.parametrize("change", [{"data_type": "string"}, {"shape": [1, 2, 3]}])
def test_an_array_of_another_layout_does_not_take_the_others_with_it(
    tmp_path: Path, array: str, change: dict[str, object]
) -> None:
    path = write_episode(tmp_path / "one.zarr")
    edit_json(path / "streams" / array / "zarr.json", lambda document: document.update(change))
    with open_episode(path) as episode:
        report = save_view(episode, tmp_path / "one.rrd")
    (shown,) = report.episodes
    assert [fault.stream for fault in shown.faults] == [array.partition("/")[0]]
    assert "width" in shown.samples


def test_times_that_go_backwards_are_reported(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "one.zarr")
    folder = path / "streams/width/time"
    shutil.rmtree(folder)
    time = times()
    writer = ArrayWriter(folder, time.dtype, (), chunk_rows=8, zstd=False)
    writer.append(time[[0, 1, 3, 2, 4]])
    writer.finish()
    with open_episode(path) as episode:
        report = save_view(episode, tmp_path / "one.rrd")
    (fault,) = report.episodes[0].faults
    assert report.is_damaged
    assert (fault.stream, fault.reason) == (
        "width",
        "`time` does not increase strictly, at sample 3",
    )
    assert "width" not in report.episodes[0].samples


def test_an_episode_that_cannot_be_opened_is_reported(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 2)
    dataset = open_dataset(root)
    (Path(dataset.episode_location(0)) / "zarr.json").write_text("{")
    report = save_view(dataset, tmp_path / "set.rrd")
    assert [one.id for one in report.unreadable] == dataset.ids[:1]
    assert [one.id for one in report.episodes] == dataset.ids[1:]
    assert report.is_damaged


def test_a_way_is_broken_where_tracking_was_lost(tmp_path: Path) -> None:
    from exumi_data.model import Frames

    with EpisodeWriter(tmp_path / "one.zarr", metadata(), durable=False) as writer:
        stream = writer.add_stream(
            "pose",
            kind="pose",
            clock=CLOCK,
            frames=Frames(parent="camera", child="tag"),
            gaps=[Gap(after=5, lost=2, reason="lost")],
        )
        poses = np.zeros((8, 7))
        poses[:, 0], poses[:, 6] = np.arange(8), 1
        flags = np.array([0, 0, 8, 0, 0, 0, 0, 0], np.uint32)
        stream.append(np.arange(8) * 10, poses, flags=flags)
    with open_episode(tmp_path / "one.zarr") as episode:
        save_view(episode, tmp_path / "one.rrd")
    (shown,) = read_view(tmp_path / "one.rrd").values()
    moved = shown.column("/space/camera/pose", "Transform3D:translation")
    assert moved.time == [0, 10, 30, 40, 50, 60, 70]
    ways = shown.fixed["/space/camera/paths/pose", "LineStrips3D:strips"]
    assert [[point[0] for point in way] for way in ways] == [[0, 1], [3, 4, 5], [6, 7]]
    # Which way is up in a frame of its own is not known.
    assert ("/space/camera", "ViewCoordinates:xyz") not in shown.fixed


def test_nothing_is_left_of_a_view_that_was_interrupted(
    everything: Everything, tmp_path: Path
) -> None:
    def interrupt(done: int, _total: int, _name: str) -> None:
        if done > 3:
            raise KeyboardInterrupt

    (tmp_path / "one.rrd").write_bytes(b"before")
    with pytest.raises(KeyboardInterrupt):
        save_view(everything.episode, tmp_path / "one.rrd", on_progress=interrupt)
    assert [path.name for path in tmp_path.iterdir()] == ["one.rrd"]
    assert (tmp_path / "one.rrd").read_bytes() == b"before"


def test_times_beyond_the_clock_are_shown_without_it(tmp_path: Path) -> None:
    with EpisodeWriter(tmp_path / "one.zarr", metadata(start=START), durable=False) as writer:
        width = writer.add_stream("width", kind="width", clock=CLOCK)
        width.append(np.array([0, 2**61]), np.array([0.0, 0.1]))
    for start in ("2200-01-01T00:00:00Z", "2299-01-01T00:00:00Z"):
        edit_metadata(tmp_path / "one.zarr", functools.partial(dict.update, start=start))
        with open_episode(tmp_path / "one.zarr") as episode:
            save_view(episode, tmp_path / "one.rrd")
        (shown,) = read_view(tmp_path / "one.rrd").values()
        column = shown.column("/width/width", "Scalars:scalars")
        assert (column.time, column.utc) == ([0, 2**61], [])


def test_a_nearly_full_disk_is_told_before_rerun_waits_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from exumi_data.view import recording

    dataset = open_dataset(write_dataset(tmp_path / "set"))
    monkeypatch.setattr(recording, "_ROOM_BYTES", 1 << 62)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OSError, match="No space left"):
        save_view(dataset, tmp_path / "view.rrd")
    assert sorted(tmp_path.iterdir()) == before
