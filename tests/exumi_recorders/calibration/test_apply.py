"""A calibration put into episodes: times and widths anew, raw ones untouched, once."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.episode import Episode, open_episode
from exumi_data.errors import UsageError
from exumi_data.model import CalibrationItem, Clock, Frames, RawData
from exumi_data.model.calibration import Intrinsics
from exumi_data.model.documents import dump
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack
from exumi_recorders.calibration.apply import NOTE, apply_calibration
from exumi_recorders.calibration.files import Calibration, array_path
from exumi_validators import validate
from tests.exumi_data.builders import HEIGHT, WIDTH, add_images, metadata

COUNT = 50
T0 = 7_000_000_000
TIME = np.arange(COUNT, dtype=np.int64) * 11_111_111
RAW = (np.linspace(3900, 4296, COUNT).astype(np.int64) % 4096).astype(np.uint16)
OLD = {"raw_to_data": {"raw": [3800, 4300], "data": [0.0, 0.1]}}
NEW = {"raw_to_data": {"raw": [3910, 4300], "data": [0.0, 0.078]}}
REFERENCE = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)


def clock(**terms: Any) -> Clock:
    return Clock(
        source="hub_monotonic", stamp_point="kernel_rx", t_ref_ns=T0, raw_time="time_host", **terms
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """An episode of poses, counts and images, with a map and a stated latency."""
    path = tmp_path / "e.zarr"
    items = {"width_map": CalibrationItem(value=OLD, method="gauge", unit="m")}
    with EpisodeWriter(path, metadata(calibration=items), durable=False) as writer:
        add_images(writer)
        pose = writer.add_stream(
            "pose", kind="pose", clock=clock(), frames=Frames(parent="world", child="controller")
        )
        pose.append(TIME, np.tile([0, 0, 0, 0, 0, 0, 1.0], (COUNT, 1)), time_host=TIME + T0)
        raw = RawData(unit="count", transform="width_map", modulus=4096)
        width = writer.add_stream("width", kind="width", clock=clock(latency_ns=1000), raw=raw)
        data = np.interp(np.where(RAW < 2000, RAW + 4096.0, RAW), [3800, 4300], [0.0, 0.1])
        width.append(TIME - 1000, data, raw=RAW, time_host=TIME + T0)
        said = {"threshold": 5.0, "size": 64, "active_above": 1e-3}
        zeros = np.zeros(5, np.float32)
        writer.add_derived(
            "tactile", "activity", zeros, algorithm="exumi-activity/1", parameters=said
        )
    return path


def codes(path: Path) -> set[str]:
    """What the validator finds."""
    return {problem.code for problem in validate(path).problems}


def latency(value: object = 30_000_000, **changes: Any) -> CalibrationItem:
    said = {"unit": "ns", "uncertainty": 2e6, "method": "exumi-sweep/1", **changes}
    return CalibrationItem(value=value, **said)


def applied(path: Path, **items: CalibrationItem) -> Any:
    renamed = {name.replace("__", "/"): item for name, item in items.items()}
    return apply_calibration(path, Calibration(renamed), "rig.json", durable=False)


def untouched(episode: Episode) -> list[bytes]:
    """The bytes of everything that no calibration changes."""
    kept = ("/time_host/", "/raw/", "/tactile/", "derived/", "/pose/data/", "/gopro/")
    return [
        episode.store.read(name)
        for name in sorted(episode.store.paths())
        if any(part in f"/{name}/" for part in kept)
    ]


def test_times_are_computed_again(path: Path) -> None:
    with open_episode(path) as episode:
        before = untouched(episode)
    done = applied(path, latency__pose=latency(), latency__nose=latency())
    assert (done.times, done.widths, done.revision) == (("pose",), (), 2)
    assert done.left_out == {"latency/nose": "the episode has no such stream"}
    with open_episode(path) as episode:
        assert np.array_equal(episode["pose"].time, TIME - 30_000_000)
        now = episode["pose"].metadata.clock
        assert (now.latency_ns, now.latency_sigma_ns) == (30_000_000, 2e6)
        assert now.method == "latency: exumi-sweep/1"
        assert np.array_equal(episode["width"].time, TIME - 1000)
        assert episode.metadata.calibration["latency/pose"] == latency()
        assert "latency/nose" not in episode.metadata.calibration
        notes = [note for note in episode.metadata.quality if note.code == NOTE]
        assert [note.message for note in notes] == ["latency/pose from rig.json"]
        assert untouched(episode) == before
        assert episode["tactile"].activity is not None
    assert codes(path) == set()


def test_once_is_enough(path: Path) -> None:
    applied(path, latency__pose=latency(), width_map=CalibrationItem(value=NEW, method="gauge"))
    with open_episode(path) as episode:
        digest = episode.digest()
    again = applied(
        path, latency__pose=latency(), width_map=CalibrationItem(value=NEW, method="gauge")
    )
    assert (again.is_changed, again.revision) == (False, 2)
    with open_episode(path) as episode:
        assert episode.digest() == digest
    back = applied(path, latency__pose=latency(0))
    assert back.revision == 3
    with open_episode(path) as episode:
        assert np.array_equal(episode["pose"].time, TIME)
        assert len([note for note in episode.metadata.quality if note.code == NOTE]) == 1


def test_widths_are_computed_again(path: Path) -> None:
    done = applied(path, width_map=CalibrationItem(value=NEW, method="gauge", unit="m"))
    assert done.widths == ("width",)
    with open_episode(path) as episode:
        width = episode["width"]
        turned = np.where(RAW < 2000, RAW + 4096.0, RAW)
        expected = np.interp(turned, [3910, 4300], [0.0, 0.078]).astype(np.float32)
        assert np.array_equal(width.data, expected)
        assert width.flags is not None
        # Counts below the map hold its end and say so.
        assert np.array_equal(width.flags == 16, turned < 3910)
        assert width.raw is not None
        assert np.array_equal(width.raw, RAW)
    assert codes(path) == set()
    applied(path, width_map=CalibrationItem(value=OLD, method="gauge", unit="m"))
    with open_episode(path) as episode:
        flags = episode["width"].flags
        assert flags is not None
        assert not flags.any()


def test_a_map_of_several_turns_is_left_out_where_counts_wrap(path: Path) -> None:
    long = {"raw_to_data": {"raw": [0, 9000], "data": [0.0, 0.1]}}
    done = applied(path, width_map=CalibrationItem(value=long, method="gauge", unit="m"))
    assert "goes over 9000 counts" in done.left_out["width_map"]
    assert not done.widths


def test_a_dry_run_writes_nothing(path: Path) -> None:
    with open_episode(path) as episode:
        digest = episode.digest()
    rig = Calibration({"latency/pose": latency()})
    done = apply_calibration(path, rig, "rig.json", dry_run=True)
    assert (done.is_changed, done.times) == (True, ("pose",))
    with open_episode(path) as episode:
        assert episode.digest() == digest


def test_what_does_not_fit_is_left_out(path: Path) -> None:
    camera = Intrinsics(model="pinhole", width=WIDTH, height=HEIGHT, fx=9, fy=9, cx=1, cy=1)
    twice = camera.model_copy(update={"width": 2 * WIDTH, "height": 2 * HEIGHT, "fx": 18, "fy": 18})
    wide = camera.model_copy(update={"width": 3 * WIDTH})
    done = applied(
        path,
        latency__pose=latency(0.5),
        latency__width=latency(unit="ms"),
        latency__tactile=latency(),
        intrinsics__gopro=CalibrationItem(value=dump(twice), method="board"),
        intrinsics__tactile=CalibrationItem(value=dump(wide), method="board"),
        intrinsics__pose=CalibrationItem(value=dump(camera), method="board"),
        width_map=CalibrationItem(value={"raw_to_data": {"raw": [2, 1], "data": [0, 1]}}),
        mm_per_px__gopro=CalibrationItem(value=[1, 1]),
        T_controller_tcp=CalibrationItem(value=[[1]], method="pivot"),
    )
    assert done.left_out == {
        "latency/pose": "its value is no whole number of ns",
        "latency/width": "its value is no whole number of ns",
        "latency/tactile": "the stream has no raw times to compute its times from",
        "intrinsics/tactile": f"intrinsics for {3 * WIDTH}x{HEIGHT} do not fit images of "
        f"{WIDTH}x{HEIGHT}. Calibrate the camera in the mode that it records in.",
        "intrinsics/pose": "the stream has no images",
        "width_map": "its `raw_to_data` has a `raw` that does not ascend",
        "mm_per_px/gopro": "the stream is not tactile",
    }
    assert set(done.changed) >= {"intrinsics/gopro", "T_controller_tcp"}
    with open_episode(path) as episode:
        # Intrinsics of the same shape are resized.
        assert episode.metadata.calibration["intrinsics/gopro"].value["fx"] == 9.0
    assert "CAL-008" not in codes(path)


def test_a_video_is_shifted(path: Path) -> None:
    with open_episode(path) as episode:
        before = episode["gopro"].time
    assert applied(path, latency__gopro=latency()).times == ("gopro",)
    with open_episode(path) as episode:
        assert np.array_equal(episode["gopro"].time, before - 30_000_000)
    assert applied(path, latency__gopro=latency(0)).times == ("gopro",)
    with open_episode(path) as episode:
        assert np.array_equal(episode["gopro"].time, before)


def place(path: Path, method: str) -> None:
    """State that the video was placed by poses that were known to 4 ms, and is known to 5 ms."""
    from tests.exumi_data.builders import edit_metadata

    said = {"method": method, "offset_sigma_ns": 5e6}
    edit_metadata(path, lambda exumi: exumi["streams"]["gopro"]["clock"].update(said))
    known = {"latency_sigma_ns": 4e6}
    edit_metadata(path, lambda exumi: exumi["streams"]["pose"]["clock"].update(known))


def test_a_clip_stays_in_step_with_the_poses_it_was_placed_by(path: Path) -> None:
    place(path, "exumi-gyro-match/1: angular speed of it against 'pose', correlation 0.998; by it")
    with open_episode(path) as episode:
        before = episode["gopro"].time
    assert applied(path, latency__pose=latency()).times == ("pose", "gopro")
    with open_episode(path) as episode:
        assert np.array_equal(episode["gopro"].time, before - 30_000_000)
        assert np.array_equal(episode["pose"].time, TIME - 30_000_000)
        now = episode["gopro"].metadata.clock
        # What the poses were uncertain by gives way to what they are now: 5, less 4, and 2 ms.
        assert now.offset_sigma_ns == pytest.approx(np.sqrt(13) * 1e6, abs=1)
    assert not applied(path, latency__pose=latency()).is_changed
    # A latency of its own comes on top, and its clock goes on telling of both.
    assert applied(path, latency__gopro=latency(5_000_000)).times == ("gopro",)
    assert applied(path, latency__pose=latency(0)).times == ("pose", "gopro")
    with open_episode(path) as episode:
        assert np.array_equal(episode["gopro"].time, before - 5_000_000)
        assert (episode["gopro"].metadata.clock.method or "").endswith(
            "by it; latency: exumi-sweep/1"
        )
    assert codes(path) == set()


def test_another_video_does_not_move_along(path: Path) -> None:
    place(path, "exumi-gyro-match/1: angular speed of it against 'head', correlation 0.998; by it")
    assert applied(path, latency__pose=latency()).times == ("pose",)


def test_a_prepared_clip_has_no_raw_times(path: Path) -> None:
    """Its times follow from nothing, so its clock states no offset; they move all the same."""
    from tests.exumi_data.builders import edit_metadata

    said = {"method": "exumi-gyro-match/1: angular speed of it against 'pose', correlation 0.998;"}
    edit_metadata(path, lambda exumi: exumi["streams"]["tactile"]["clock"].update(said))
    with open_episode(path) as episode:
        before = episode["tactile"].time
    assert applied(path, latency__pose=latency()).times == ("pose", "tactile")
    with open_episode(path) as episode:
        assert np.array_equal(episode["tactile"].time, before - 30_000_000)
        assert episode["tactile"].metadata.clock.offset_ns == 0
    assert codes(path) == set()


def test_what_is_no_latency_and_maps_of_another_name(path: Path) -> None:
    new = CalibrationItem(value=NEW, method="gauge", unit="m")
    done = applied(path, latency__pose=latency(2**62), other_map=new)
    assert done.left_out == {
        "latency/pose": "4.61169e+09 s are no latency",
        "other_map": "no width is by a map of this name: 'width' is by 'width_map'",
    }
    assert not done.is_changed
    turned = np.where(RAW < 2000, RAW + 4096.0, RAW)
    assert applied(path, width_map=new).out_of_range == {"width": int((turned < 3910).sum())}


def test_arrays_and_scale(path: Path) -> None:
    name = "tactile_reference/tactile"
    item = CalibrationItem(value=None, method="capture", array=array_path(name))
    said = {"mm_per_px/tactile": CalibrationItem(value=[0.05, 0.06], unit="mm", method="rule")}
    for level in (0, 1):
        rig = Calibration({name: item, **said}, {name: REFERENCE + np.uint8(level)})
        for changed in (True, False):
            done = apply_calibration(path, rig, "rig.json", durable=False)
            assert done.is_changed is changed
        with open_episode(path) as episode:
            assert np.array_equal(episode.calibration_array(name), REFERENCE + level)
            assert episode["tactile"].metadata.model_dump()["mm_per_px"] == [0.05, 0.06]
    small = Calibration({name: item}, {name: REFERENCE[1:]})
    left = apply_calibration(path, small, "rig.json").left_out
    assert left == {name: f"an array of (23, 32, 3) for images of {HEIGHT}x{WIDTH}"}


def test_times_that_are_not_the_clocks_stay(path: Path) -> None:
    from tests.exumi_data.builders import edit_metadata

    edit_metadata(path, lambda exumi: exumi["streams"]["pose"]["clock"].update(offset_ns=5))
    done = applied(path, latency__pose=latency())
    assert "not what its clock makes" in done.left_out["latency/pose"]


def test_a_packed_episode_is_not_changed(path: Path) -> None:
    packed = pack(path)
    with pytest.raises(UsageError, match="is packed"):
        apply_calibration(packed, Calibration({"a": latency()}), "rig.json")
