"""Training sets of rectified, combined and undistorted frames."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from exumi_converters import prepare
from exumi_converters.resize import resize
from exumi_data.calibration import add_intrinsics, add_rectification, intrinsics_of
from exumi_data.camera import Undistorter, pinhole, resized
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.episode import Episode, open_episode
from exumi_data.model import (
    ArrayImages,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    EpisodeMetadata,
    Frames,
    Gap,
    LossyStep,
    QualityNote,
    Sensor,
    Source,
    TactileStream,
    Task,
)
from exumi_data.model.calibration import Intrinsics
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import ActivityMeter, to_grey
from exumi_data.tactile.rectification import PixelMap
from exumi_validators import validate

ID = "0190a1b2-0000-7000-8000-000000000002"
COUNT, STEP = 30, 33_000_000
HEIGHT, WIDTH = 60, 80
CROP = (44, 56)
CAMERA = Intrinsics(
    model="fisheye", width=96, height=64, fx=30, fy=31, cx=47, cy=33, distortion=[0.01, 0, 0, 0]
)


def gel(count: int, seed: int, channels: int = 3) -> np.ndarray:
    """(N, H, W, C) frames: a patterned gel on which something moves in the last third."""
    rng = np.random.default_rng(seed)
    base = cv2.GaussianBlur(rng.uniform(60, 180, (HEIGHT, WIDTH, 3)), (0, 0), 4)[..., :channels]
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    frames = np.repeat(base[None], count, axis=0)
    for index in range(2 * count // 3, count):
        blob = np.exp(-((x - 30 - index // 2) ** 2 + (y - 30) ** 2) / 40)
        frames[index] += (45 * blob)[..., None]
    noise = rng.normal(0, 0.7, frames.shape)
    return np.asarray((frames + noise).clip(0, 255), np.uint8)


def pixel_map(seed: int) -> PixelMap:
    """A map that bends: no two fingers have the same."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    bent = 3 * np.sin(x / 9 + seed), 4 * np.cos(y / 8 + seed)
    places = np.stack([(y + bent[0]).clip(0, HEIGHT - 1), (x + bent[1]).clip(0, WIDTH - 1)], -1)
    scale = (0.05 + 0.002 * seed, 0.06 + 0.002 * seed)
    return PixelMap(places.astype(np.uint16), (29.0, 41.0), CROP, scale)


def rectified(image: np.ndarray, used: PixelMap) -> np.ndarray:
    """By the formula: index, then cut."""
    whole = image[used.index[..., 0], used.index[..., 1]]
    return whole[29 - 22 : 29 + 22, 41 - 28 : 41 + 28]


@dataclass
class Play:
    """What the episode is made of."""

    left: np.ndarray = field(default_factory=lambda: gel(COUNT, 1))
    right: np.ndarray = field(default_factory=lambda: gel(COUNT, 2))
    left_time: np.ndarray = field(default_factory=lambda: np.arange(COUNT) * STEP)
    right_time: np.ndarray = field(default_factory=lambda: np.arange(COUNT) * STEP + 5_000_000)
    maps: dict[str, PixelMap] = field(
        default_factory=lambda: {"left": pixel_map(1), "right": pixel_map(2)}
    )
    names: tuple[str, str] = ("tactile_left", "tactile_right")
    sides: tuple[str | None, str | None] = ("left", "right")
    references: bool = True
    camera: Intrinsics | None = field(default_factory=CAMERA.model_copy)
    gaps: list[Gap] | None = None
    flags: bool = False


def write(root: Path, play: Play) -> Path:
    create_dataset(root, DatasetMetadata(name="play", licence="CC0-1.0", splits=[]))
    lossy = [LossyStep(step="dim", stream=play.names[1], detail="the light was low")]
    note = QualityNote(code="gel", message="it is worn", stream=play.names[0])
    metadata = EpisodeMetadata(
        id=ID,
        task=Task(name="play"),
        regime="demonstration",
        licence="CC0-1.0",
        source=Source(type="recorded", tool="test", tool_version="1", lossy=lossy),
        calibration={"latency": CalibrationItem(value=0.02, unit="s", method="taps")},
        quality=[note],
    )
    with EpisodeWriter(root / "episodes" / "02" / f"{ID}.zarr", metadata, durable=False) as writer:
        for index, side in enumerate(("left", "right")):
            write_finger(writer, play, index, side)
        images = ArrayImages(encoding="array", height=64, width=96, channels=3)
        rgb = writer.add_stream("rgb", kind="rgb", images=images)
        y, x = np.mgrid[:64, :96]
        views = [np.stack([x * 2, y * 3, x * 0 + 7 * i], -1).astype(np.uint8) for i in range(8)]
        rgb.append(np.arange(8) * 4 * STEP, np.stack(views))
        if play.camera is not None:
            add_intrinsics(writer, "rgb", play.camera, method="a board", residual=0.2)
        pose = writer.add_stream("pose", kind="pose", frames=Frames(parent="world", child="tcp"))
        still = np.tile([0.0, 0, 0, 0, 0, 0, 1], (COUNT, 1))
        still[:, 0] = np.arange(COUNT) * 1e-3
        pose.append(np.arange(COUNT) * STEP, still)
        writer.add_calibration_array("other/table", np.arange(6.0).reshape(2, 3))
        writer.metadata.calibration["other"] = CalibrationItem(
            value=None, array="calibration/other/table", method="measured"
        )
    return root


def write_finger(writer: EpisodeWriter, play: Play, index: int, side: str) -> None:
    frames = (play.left, play.right)[index]
    time = (play.left_time, play.right_time)[index]
    name = play.names[index]
    sensor = Sensor(model="9dtact", serial=side, side=play.sides[index])  # type: ignore[arg-type]  # left, right or None
    channels = frames.shape[3]
    stream = writer.add_stream(
        name,
        kind="tactile",
        clock=Clock(source="hub_monotonic", stamp_point="kernel_rx", raw_time="time_host"),
        images=ArrayImages(encoding="array", height=HEIGHT, width=WIDTH, channels=channels),
        sensor=sensor,
        gaps=play.gaps if side == "left" else None,
        description="a finger",
    )
    flags = {"flags": np.arange(len(time)) % 2 << index} if play.flags else {}
    stream.append(time, frames, time_host=time, **flags)
    if play.references:
        stream.set_reference(frames[0], method="captured", contact_free=True)
    if side in play.maps:
        add_rectification(writer, name, play.maps[side], method="dots")
    rig = f"tactile_reference/{name}"
    writer.add_calibration_array(rig, frames[0])
    writer.metadata.calibration[rig] = CalibrationItem(
        value=None, array=f"calibration/{rig}", method="captured without contact"
    )


Made = Callable[..., Episode]


@pytest.fixture
def make(tmp_path: Path) -> Made:
    """Write an episode, prepare it, check that nothing is wrong with it, open it."""

    def make(play: Play | None = None, allowed: tuple[str, ...] = (), **options: Any) -> Episode:
        root = write(tmp_path / "play", play or Play())
        options = {"size": 32, "lossless": True, **options}
        report = prepare(root, tmp_path / "train", workers=1, **options)
        assert report.failed == (), report.failed
        assert [p for p in validate(tmp_path / "train").problems if p.code not in allowed] == []
        again = prepare(root, tmp_path / "train", workers=1, **options)
        assert (again.converted, again.skipped) == (0, 1)
        return open_dataset(tmp_path / "train")[0]

    return make


def failure(tmp_path: Path, play: Play, **options: Any) -> str:
    root = write(tmp_path / "play", play)
    report = prepare(root, tmp_path / "train", workers=1, size=32, **options)
    assert report.converted == 0
    (failed,) = report.failed
    return failed.reason


def tactile(episode: Episode, name: str) -> TactileStream:
    model = episode[name].metadata
    assert isinstance(model, TactileStream)
    return model


def steps_of(episode: Episode) -> dict[tuple[str, str | None], LossyStep]:
    return {(s.step, s.stream): s for s in episode.metadata.source.lossy or []}


# --------------------------------------------------------------------------------------- separate


def test_fingers_are_rectified_where_there_is_a_map(make: Made) -> None:
    play = Play()
    del play.maps["right"]
    episode = make(play)
    left, right = episode["tactile_left"], episode["tactile_right"]
    expected = [resize(rectified(frame, play.maps["left"]), 32) for frame in play.left]
    assert np.array_equal(left.frames[:], np.stack(expected))
    assert np.array_equal(left.reference, expected[0])  # type: ignore[arg-type]  # there is one
    assert np.array_equal(right.frames[:], np.stack([resize(f, 32) for f in play.right]))
    steps = steps_of(episode)
    assert ("rectify", "tactile_right") not in steps
    assert steps["rectify", "tactile_left"].parameters is not None
    assert steps["rectify", "tactile_left"].parameters["crop"] == [7, 13, 44, 56]
    assert steps["resize", "tactile_left"].parameters is not None
    assert steps["resize", "tactile_left"].parameters["from"] == [56, 44]
    assert tactile(episode, "tactile_left").mm_per_px == pytest.approx(
        [0.052 * 56 / 32, 0.062 * 44 / 32]
    )
    assert tactile(episode, "tactile_right").mm_per_px is None


def test_activity_is_that_of_the_rectified_frames(make: Made) -> None:
    play = Play()
    episode = make(play)
    greys = [to_grey(rectified(frame, play.maps["left"])) for frame in play.left]
    meter = ActivityMeter(greys[0])
    expected = np.array([meter.measure(grey) for grey in greys], np.float32)
    assert expected.max() > 0.02
    assert np.array_equal(episode["tactile_left"].activity, expected)  # type: ignore[arg-type]  # there is one
    assert episode.derived is not None
    item = episode.derived.items["tactile_left/activity"]
    assert item.inputs[-1] == f"{ID}/calibration/rectification/tactile_left"


def test_calibration_is_changed_as_the_images_are(make: Made, tmp_path: Path) -> None:
    play = Play()
    episode = make(play)
    items = episode.metadata.calibration
    assert set(items) == {
        "latency",
        "other",
        "intrinsics/rgb",
        "tactile_reference/tactile_left",
        "tactile_reference/tactile_right",
    }
    assert np.array_equal(episode.calibration_array("other"), np.arange(6.0).reshape(2, 3))
    for name in ("tactile_left", "tactile_right"):
        image = episode.calibration_array(f"tactile_reference/{name}")
        assert np.array_equal(image, episode[name].reference)  # type: ignore[arg-type]  # there is one
    assert intrinsics_of(episode, "rgb") == resized(CAMERA, 32, 32)
    assert items["intrinsics/rgb"].method == "a board"
    # The residual was in pixels of another size.
    assert items["intrinsics/rgb"].residual is None
    assert not (Path(episode.path) / "calibration" / "rectification").exists()


def test_what_was_rectified_is_not_rectified_again(make: Made, tmp_path: Path) -> None:
    once = make()
    report = prepare(tmp_path / "train", tmp_path / "twice", size=32, lossless=True, workers=1)
    assert report.failed == ()
    twice = open_dataset(tmp_path / "twice")[0]
    assert np.array_equal(twice["tactile_left"].frames[:], once["tactile_left"].frames[:])
    assert twice.metadata.source.lossy == once.metadata.source.lossy
    assert np.array_equal(twice["tactile_left"].activity, once["tactile_left"].activity)  # type: ignore[arg-type]  # both have it


# --------------------------------------------------------------------------------------- combined


def combined(left: np.ndarray, right: np.ndarray, play: Play) -> np.ndarray:
    """By the released code's formula."""
    if play.maps:
        left, right = rectified(left, play.maps["left"]), rectified(right, play.maps["right"])
    turned = (
        cv2.rotate(left, cv2.ROTATE_90_COUNTERCLOCKWISE),
        cv2.rotate(right, cv2.ROTATE_90_CLOCKWISE),
    )
    image = cv2.hconcat(turned)
    return image.reshape(*image.shape[:2], -1)


@pytest.mark.parametrize("with_maps", [True, False])
def test_two_fingers_become_one_stream(make: Made, *, with_maps: bool) -> None:
    play = Play() if with_maps else Play(maps={})
    episode = make(play, tactile="combined")
    assert list(episode) == ["tactile_combined", "rgb", "pose"]
    stream = episode["tactile_combined"]
    native = [combined(a, b, play) for a, b in zip(play.left, play.right, strict=True)]
    assert native[0].shape == ((56, 88, 3) if with_maps else (80, 120, 3))
    assert np.array_equal(stream.frames[:], np.stack([resize(f, 32) for f in native]))
    assert np.array_equal(stream.reference, resize(native[0], 32))  # type: ignore[arg-type]  # there is one
    assert np.array_equal(stream.time, play.left_time)
    assert np.array_equal(stream.time_host, play.left_time)  # type: ignore[arg-type]  # there is one
    meter = ActivityMeter(to_grey(native[0]))
    expected = [meter.measure(to_grey(frame)) for frame in native]
    assert np.array_equal(stream.activity, np.array(expected, np.float32))  # type: ignore[arg-type]  # there is one
    assert episode.derived is not None
    assert list(episode.derived.items) == ["tactile_combined/activity"]
    assert episode.derived.items["tactile_combined/activity"].parameters["active_above"] == 5e-4
    model = tactile(episode, "tactile_combined")
    assert model.reference is not None
    assert (model.reference.method, model.reference.contact_free) == ("captured", True)
    assert model.sensor == Sensor(model="9dtact")
    assert (model.description, model.gaps) == ("a finger", None)
    scale = [0.063 * 88 / 32, 0.053 * 56 / 32] if with_maps else None
    assert model.mm_per_px == (scale if scale is None else pytest.approx(scale))
    # Nothing that is known of one finger's images is said of both.
    assert set(episode.metadata.calibration) == {"latency", "other", "intrinsics/rgb"}


def test_what_was_said_of_a_finger_is_said_of_what_it_became(make: Made) -> None:
    episode = make(tactile="combined", gray=True, lossless=False)
    (note,) = episode.metadata.quality
    assert (note.stream, note.message) == ("tactile_combined", "tactile_left: it is worn")
    steps = [(s.step, s.stream) for s in episode.metadata.source.lossy or []]
    assert steps == [
        ("dim", "tactile_combined"),
        ("grey", "tactile_combined"),
        ("rectify", "tactile_combined"),
        ("rectify", "tactile_combined"),
        ("combine", "tactile_combined"),
        ("resize", "tactile_combined"),
        ("jpeg-encode", "tactile_combined"),
        ("resize", "rgb"),
        ("jpeg-encode", "rgb"),
    ]
    assert episode["tactile_combined"].frames.shape == (COUNT, 32, 32, 1)


def test_frames_are_paired_with_the_nearest_and_never_blended(make: Made) -> None:
    # The right finger is slower, begins late and pauses.
    right = np.concatenate([np.arange(3, 8), np.arange(14, 19)]) * 50_000_000
    play = Play(right=gel(10, 2), right_time=right, maps={})
    play.gaps = [Gap(after=-1, reason="warm-up"), Gap(after=20, lost=2, reason="usb")]
    play.left_time = np.arange(COUNT) * STEP
    play.left_time[21:] += 2 * STEP
    episode = make(play, tactile="combined", pair_within_s=0.025)
    distance = np.abs(play.left_time[:, None] - right)
    kept = np.flatnonzero(distance.min(axis=1) <= 25_000_000)
    partner = distance.argmin(axis=1)[kept]
    assert 5 < len(kept) < COUNT
    stream = episode["tactile_combined"]
    expected = [combined(play.left[i], play.right[j], play) for i, j in zip(kept, partner)]  # noqa: B905  # indices, one each
    assert np.array_equal(stream.frames[:], np.stack([resize(f, 32) for f in expected]))
    assert np.array_equal(stream.time, play.left_time[kept])
    step = steps_of(episode)["combine", "tactile_combined"]
    assert step.parameters is not None
    assert step.parameters["left_dropped"] == COUNT - len(kept)
    assert step.parameters["right_unused"] == len(right) - len(set(partner))
    assert step.parameters["right_used_again"] == len(partner) - len(set(partner))
    assert step.parameters["most_apart_ns"] == distance.min(axis=1)[kept].max()
    gaps = episode["tactile_combined"].metadata.gaps
    assert gaps is not None
    assert gaps[0].after == -1
    assert gaps[0].lost is None  # warm-up: nobody knows
    # Every pair of frames that were not neighbours has a gap between them, with what is missing.
    missing = np.diff(kept) - 1
    missing[np.flatnonzero((kept[:-1] <= 20) & (kept[1:] > 20))] += 2
    found = {gap.after: gap.lost for gap in gaps if 0 <= gap.after < len(kept) - 1}
    assert found == {int(i): int(missing[i]) for i in np.flatnonzero(missing)}
    assert any(gap.reason and "usb" in gap.reason for gap in gaps)
    assert any(gap.reason == "no frame of the other finger" for gap in gaps)


def test_by_default_frames_are_an_interval_apart_at_most(make: Made) -> None:
    play = Play(maps={})
    play.right_time = play.left_time[:10] + STEP // 2
    play.right = play.right[:10]
    episode = make(play, tactile="combined")
    # The last right frame is the nearest of the two left ones after it, too.
    assert len(episode["tactile_combined"]) == 11
    step = steps_of(episode)["combine", "tactile_combined"]
    assert step.parameters is not None
    assert step.parameters["pair_within_ns"] == STEP
    assert step.parameters["left_dropped"] == COUNT - 11


def test_flags_of_both_fingers_hold(make: Made) -> None:
    episode = make(Play(flags=True, maps={}), tactile="combined")
    flags = episode["tactile_combined"].flags
    assert flags is not None
    assert flags.tolist() == [0, 3] * (COUNT // 2)


def test_references_are_selected_where_there_are_none(make: Made) -> None:
    play = Play(references=False)
    episode = make(play, tactile="combined")
    about = tactile(episode, "tactile_combined").reference
    assert about is not None
    assert (about.method, about.contact_free) == ("selected", True)
    reference = episode["tactile_combined"].reference
    assert reference is not None
    # The first frames are without contact.
    first = resize(combined(play.left[0], play.right[0], play), 32)
    assert np.abs(reference.astype(int) - first).max() <= 4
    activity = episode["tactile_combined"].activity
    assert activity is not None
    assert activity[: COUNT // 2].max() == 0
    assert activity[-3:].min() > 5e-4


def test_a_reference_that_may_hold_contact_is_noted(make: Made) -> None:
    still = Play(references=False)
    still.left = still.right = np.repeat(gel(1, 4), COUNT, axis=0)
    still.left = still.left + np.arange(COUNT, dtype=np.uint8)[:, None, None, None] % 2
    still.right = still.left.copy()
    episode = make(still, ("TACT-005",), tactile="combined")
    notes = [n for n in episode.metadata.quality if n.code == "reference-estimated"]
    assert [(n.stream, n.message.partition(":")[0]) for n in notes] == [
        ("tactile_combined", "tactile_left"),
        ("tactile_combined", "tactile_right"),
    ]
    about = tactile(episode, "tactile_combined").reference
    assert about is not None
    assert (about.method, about.contact_free) == ("estimated", None)


def test_fingers_of_other_names_are_told_by_their_side(make: Made) -> None:
    play = Play(names=("thumb", "index"), sides=("left", "right"))
    episode = make(play, tactile="combined")
    first = combined(play.left[0], play.right[0], play)
    assert np.array_equal(episode["tactile_combined"].frames[0], resize(first, 32))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"maps": {"left": pixel_map(1)}}, "map of one finger only"),
        ({"names": ("thumb", "index"), "sides": (None, None)}, "no left and right finger"),
        ({"sides": ("right", None)}, "'tactile_left' is said to be on the right"),
        ({"right_time": np.arange(COUNT) * STEP + 10**12}, "no two frames are within"),
        ({"right": gel(COUNT, 2, 1)}, "one has colour, the other none"),
    ],
)
def test_what_cannot_be_combined_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    assert message in failure(tmp_path, Play(**changes), tactile="combined")


def test_colour_and_grey_are_combined_in_grey(make: Made) -> None:
    play = Play(right=gel(COUNT, 2, 1), maps={})
    episode = make(play, tactile="combined", gray=True)
    first = combined(to_grey(play.left[0])[..., None], play.right[0], play)
    assert np.array_equal(episode["tactile_combined"].frames[0], resize(first, 32))


# -------------------------------------------------------------------------------------------- rgb


def test_cameras_are_undistorted(make: Made) -> None:
    episode = make(rgb="rectify", fov_deg=70)
    root = Path(episode.path).parents[3] / "play"
    (path,) = root.glob("episodes/*/*.zarr")
    with open_episode(path) as parent:
        expected = [Undistorter(CAMERA, pinhole(32, 70))(f) for f in parent["rgb"].frames[:]]
    assert np.array_equal(episode["rgb"].frames[:], np.stack(expected))
    assert intrinsics_of(episode, "rgb") == pinhole(32, 70)
    step = steps_of(episode)["undistort", "rgb"]
    assert step.parameters is not None
    assert (step.parameters["fov_deg"], step.parameters["not_seen"]) == (70, 0)
    assert step.parameters["intrinsics"]["distortion"] == [0.01, 0, 0, 0]
    assert ("resize", "rgb") not in steps_of(episode)


def test_undistorted_frames_are_copied_only_for_the_same_view(make: Made, tmp_path: Path) -> None:
    make(rgb="rectify", fov_deg=70)
    for fov, found in ((70, 1), (50, 2)):
        options = {"size": 32, "lossless": True, "rgb": "rectify", "fov_deg": fov}
        target = tmp_path / f"fov{fov}"
        assert prepare(tmp_path / "train", target, workers=1, **options).failed == ()  # type: ignore[arg-type]  # options of several types
        steps = open_dataset(target)[0].metadata.source.lossy or []
        assert sum(step.step == "undistort" for step in steps) == found


def test_a_camera_that_is_not_known_is_not_rectified(tmp_path: Path) -> None:
    reason = failure(tmp_path, Play(camera=None), rgb="rectify")
    assert "the intrinsics of 'rgb' are not known" in reason
    assert "intrinsics/rgb" in reason


# ------------------------------------------------------------------------------------ the run


def test_other_settings_are_refused_and_named(make: Made, tmp_path: Path) -> None:
    from exumi_data.errors import UsageError

    make(tactile="combined")
    with pytest.raises(UsageError, match=r"tactile combined \(now separate\)"):
        prepare(tmp_path / "play", tmp_path / "train", size=32, lossless=True)
    with pytest.raises(UsageError, match="pair_within_ns None"):
        prepare(
            tmp_path / "play",
            tmp_path / "train",
            size=32,
            lossless=True,
            tactile="combined",
            pair_within_s=0.01,
        )


@pytest.mark.parametrize(
    "options",
    [{"tactile": "both"}, {"rgb": "crop"}, {"fov_deg": 171}, {"pair_within_s": -0.1}],
)
def test_options_out_of_range_are_refused(tmp_path: Path, options: dict[str, Any]) -> None:
    from exumi_data.errors import UsageError

    with pytest.raises(UsageError, match="Invalid"):
        prepare(tmp_path, tmp_path / "train", **options)


def test_a_map_that_does_not_fit_fails_by_name(tmp_path: Path) -> None:
    small = PixelMap(np.zeros((20, 20, 2), np.uint16), (10, 10), (4, 4))
    reason = failure(tmp_path, Play(maps={"left": small}))
    assert "(20, 20, 2)" in reason
    assert "rectification/tactile_left" in reason


@pytest.mark.parametrize(
    "place", ["calibration/tactile_reference/tactile_left", "streams/tactile_left/reference"]
)
def test_a_reference_of_another_size_fails_by_name(tmp_path: Path, place: str) -> None:
    root = write(tmp_path / "play", Play())
    (path,) = root.glob("episodes/*/*.zarr")
    other = EpisodeMetadata(**open_episode(path).metadata.model_dump(exclude={"streams"}))
    other.calibration = {}
    with EpisodeWriter(tmp_path / "other.zarr", other, durable=False) as writer:
        writer.add_calibration_array("small", np.zeros((20, 30, 3), np.uint8))
    shutil.rmtree(path / place)
    shutil.copytree(tmp_path / "other.zarr" / "calibration" / "small", path / place)
    (failed,) = prepare(root, tmp_path / "train", workers=1, size=32).failed
    assert "(20, 30, 3)" in failed.reason
    assert "tactile_left" in failed.reason
    assert "defect" not in failed.reason
