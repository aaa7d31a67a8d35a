"""Episodes to training sets: what is resized, what is carried along, what is on record."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from exumi_converters import ConversionReport, PrepareReport, prepare
from exumi_converters.resize import resize
from exumi_data.dataset import Dataset, create_dataset, open_dataset
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import NotAnEpisodeError, UsageError
from exumi_data.model import (
    ArrayImages,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Gap,
    RawData,
    Source,
    TactileStream,
    Task,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import ActivityMeter, reference_image, to_grey
from tests.exumi_data.builders import edit_metadata

Run = Callable[..., tuple[ConversionReport, Dataset]]
PARENT = "0190a1b2-0000-7000-8000-000000000001"
COUNT = 40


@pytest.fixture
def play(tmp_path: Path, make_frames: Any) -> Path:
    """One episode with everything: two tactile streams, a camera, pose with raw and host times."""
    root = create_dataset(
        tmp_path / "play",
        DatasetMetadata(name="play", licence="CC-BY-4.0", citation="Doe 2026", splits=[]),
    )
    metadata = EpisodeMetadata(
        id=PARENT,
        task=Task(name="play"),
        regime="play",
        licence="CC-BY-4.0",
        calibration={"latency": CalibrationItem(value=0.02, unit="s")},
        source=Source(type="simulated", tool="test", tool_version="1"),
    )
    frames = make_frames(COUNT)
    time = np.arange(COUNT, dtype=np.int64) * 40_000_000 + 7
    path = root / "episodes" / "01" / f"{PARENT}.zarr"
    size = {"height": frames[0].shape[0], "width": frames[0].shape[1]}
    with EpisodeWriter(path, metadata, durable=False) as writer:
        tactile = writer.add_stream(
            "tactile_left",
            kind="tactile",
            clock=Clock(source="hub_monotonic", stamp_point="kernel_rx", raw_time="time_host"),
            images=EncodedImages(encoding="encoded", media_type="image/jpeg", channels=3, **size),
            nominal_rate="25/1",
            mm_per_px=[0.02, 0.03],
            gaps=[Gap(after=3, lost=1)],
        )
        tactile.append(
            time,
            [jpeg.encode(frame, 95) for frame in frames],
            time_host=time + 5,
            sequence=np.arange(COUNT),
            flags=np.zeros(COUNT, np.uint32),
        )
        tactile.set_reference(frames[0], method="captured", frames=[0], contact_free=True)
        rgb = writer.add_stream(
            "rgb", kind="rgb", images=ArrayImages(encoding="array", channels=3, **size)
        )
        rgb.append(time, np.stack(frames))
        pose = writer.add_stream(
            "pose",
            kind="pose",
            frames=Frames(parent="world", child="tcp"),
            raw=RawData(unit="m", transform="latency"),
        )
        poses = np.random.default_rng(0).normal(size=(5000, 7))
        pose.append(np.arange(5000) * 10, poses, raw=poses + 1, time_host=np.arange(5000) * 10 + 3)
        writer.add_derived(
            "tactile_left",
            "activity",
            np.linspace(0, 1, COUNT, dtype=np.float32),
            algorithm="exumi-activity/1",
            parameters={"threshold": 5.83, "size": 224, "active_above": 1e-3},
            inputs=["streams/tactile_left/data"],
        )
        writer.add_derived("tactile_left", "salient", np.array([3, 5]), algorithm="x/1")
    return root


def made(source: Path, destination: Path, **options: Any) -> tuple[PrepareReport, Dataset]:
    report = prepare(source, destination, workers=1, **options)
    assert report.failed == ()
    return report, open_dataset(destination)


def tactile(episode: Episode, name: str = "tactile") -> TactileStream:
    model = episode[name].metadata
    assert isinstance(model, TactileStream)
    return model


def files_of(episode: Episode, prefix: str) -> dict[str, bytes]:
    paths = [path for path in episode.store.paths() if path.startswith(prefix)]
    return {path: episode.store.read(path) for path in paths}


# ------------------------------------------------------------------------------------- what is made


def test_frames_are_resized_once_and_stored_as_jpeg(octopi: Path, run: Run, tmp_path: Path) -> None:
    _, native = run(octopi, "octopi")
    report, dataset = made(tmp_path / "out", tmp_path / "train", size=96)
    assert (report.converted, report.frames) == (5, 150)
    parents = {episode.id: episode for episode in native}
    for episode in dataset:
        parent = parents[str(episode.metadata.source.parent_id)]
        images = tactile(episode).images
        assert images == EncodedImages(
            encoding="encoded", media_type="image/jpeg", height=96, width=96, channels=3
        )
        originals = parent["tactile"].frames
        expected = np.stack(
            [cv2.resize(f, (96, 96), interpolation=cv2.INTER_AREA) for f in originals]
        )
        frames = episode["tactile"].frames[:]
        assert np.abs(frames.astype(int) - expected).mean() < 2
        assert np.array_equal(episode["tactile"].time, parent["tactile"].time)
        # What is stored is exactly what our encoder makes of the resized frame.
        assert episode["tactile"].encoded(7) == jpeg.encode(expected[7], 95)
        assert episode["tactile"].metadata.clock == parent["tactile"].metadata.clock
        assert episode["tactile"].metadata.nominal_rate == "25/1"


def test_what_was_derived_is_carried_along(octopi: Path, run: Run, tmp_path: Path) -> None:
    _, native = run(octopi, "octopi")
    _, dataset = made(tmp_path / "out", tmp_path / "train", size=96)
    parents = {episode.id: episode for episode in native}
    for episode in dataset:
        parent = parents[str(episode.metadata.source.parent_id)]
        assert np.array_equal(episode["tactile"].activity, parent["tactile"].activity)  # type: ignore[arg-type]  # both have it
        assert np.array_equal(episode["tactile"].salient, parent["tactile"].salient)  # type: ignore[arg-type]  # both have it
        assert episode.derived is not None
        assert parent.derived is not None
        for key, item in episode.derived.items.items():
            before = parent.derived.items[key]
            assert (item.algorithm, item.parameters) == (before.algorithm, before.parameters)
            assert item.inputs == [f"{parent.id}/{path}" for path in before.inputs]


def test_the_reference_takes_the_frames_path(octopi: Path, run: Run, tmp_path: Path) -> None:
    _, native = run(octopi, "octopi")
    _, colour = made(tmp_path / "out", tmp_path / "train", size=96)
    _, grey = made(tmp_path / "out", tmp_path / "grey", size=96, gray=True)
    parents = {episode.id: episode["tactile"] for episode in native}
    for episode in colour:
        reference = parents[str(episode.metadata.source.parent_id)].reference
        assert reference is not None
        assert np.array_equal(episode["tactile"].reference, resize(reference, 96))  # type: ignore[arg-type]  # there is one
        about = tactile(native[str(episode.metadata.source.parent_id)]).reference
        assert tactile(episode).reference == about
    for episode in grey:
        reference = parents[str(episode.metadata.source.parent_id)].reference
        assert reference is not None
        expected = resize(to_grey(reference)[..., None], 96)
        assert np.array_equal(episode["tactile"].reference, expected)  # type: ignore[arg-type]  # there is one


def test_lossless_pixels_are_exact(octopi: Path, run: Run, tmp_path: Path) -> None:
    _, native = run(octopi, "octopi")
    _, dataset = made(tmp_path / "out", tmp_path / "train", size=96, gray=True, lossless=True)
    for episode in dataset:
        parent = native[str(episode.metadata.source.parent_id)]["tactile"]
        luma = parent.frames.read(range(len(parent)), grey=True)
        expected = [resize(frame, 96) for frame in luma]
        assert np.array_equal(episode["tactile"].frames[:], np.stack(expected))
        assert [s.step for s in episode.metadata.source.lossy or []] == [
            "video-encode",
            "grey",
            "resize",
        ]


def test_every_lossy_step_is_named(octopi: Path, run: Run, tmp_path: Path) -> None:
    run(octopi, "octopi")
    _, dataset = made(tmp_path / "out", tmp_path / "train", size=96, gray=True, quality=80)
    steps = {step.step: step for step in dataset[0].metadata.source.lossy or []}
    assert list(steps) == ["video-encode", "grey", "resize", "jpeg-encode"]
    assert steps["resize"].parameters == {
        "from": [160, 120],
        "to": [96, 96],
        "interpolation": "area",
    }
    assert steps["jpeg-encode"].parameters == {"quality": 80}
    assert "decoded from video" in steps["jpeg-encode"].detail
    _, colour = made(tmp_path / "out", tmp_path / "colour", size=200)
    steps = {step.step: step for step in colour[0].metadata.source.lossy or []}
    assert steps["jpeg-encode"].parameters == {"quality": 95, "subsampling": "4:2:0"}
    assert steps["resize"].parameters is not None
    assert steps["resize"].parameters["interpolation"] == "linear"


def test_parent_settings_and_annotations_are_on_record(
    octopi: Path, labels: Path, run: Run, tmp_path: Path
) -> None:
    _, native = run(octopi, "octopi", labels=labels)
    _, dataset = made(tmp_path / "out", tmp_path / "train", size=96)
    assert len({episode.id for episode in dataset} | {episode.id for episode in native}) == 10
    for episode in dataset:
        source = episode.metadata.source
        parent = native[str(source.parent_id)]
        assert source.parent_digest == parent.digest()
        assert (source.converter, source.key) == ("prepare/1", parent.id)
        assert source.settings is not None
        assert (source.settings["size"], source.settings["quality"]) == (96, 95)
        assert source.settings["parent_source_type"] == "converted"
        assert episode.metadata.annotations == parent.metadata.annotations
        assert episode.metadata.quality == parent.metadata.quality
        assert episode.id[14] == "5"


def test_splits_name_the_new_episodes(octopi: Path, labels: Path, run: Run, tmp_path: Path) -> None:
    _, native = run(octopi, "octopi", labels=labels)
    _, dataset = made(tmp_path / "out", tmp_path / "train", size=96)
    new = {str(e.metadata.source.parent_id): e.id for e in dataset}
    assert list(dataset.splits) == list(native.splits) == ["octopi1"]
    for name, split in native.splits.items():
        expected = {k: sorted(new[i] for i in ids) for k, ids in split.lists.items()}
        assert dataset.splits[name].lists == expected
        assert dataset.splits[name].level == split.level


def test_everything_else_is_copied_byte_for_byte(play: Path, tmp_path: Path) -> None:
    _, native = open_dataset_pair(play)
    _, dataset = made(play, tmp_path / "train", size=64)
    (episode,) = dataset
    pose = files_of(episode, "streams/pose/")
    assert len(pose) == 9
    assert pose == files_of(native, "streams/pose/")
    assert episode["pose"].metadata == native["pose"].metadata
    left, before = episode["tactile_left"], native["tactile_left"]
    for name in ("time", "time_host", "sequence", "flags"):
        assert np.array_equal(left.array(name), before.array(name))
    assert left.metadata.clock == before.metadata.clock
    assert left.metadata.gaps == before.metadata.gaps
    assert tactile(episode, "tactile_left").mm_per_px == pytest.approx(
        [0.02 * 160 / 64, 0.03 * 120 / 64]
    )
    assert episode["rgb"].frames.shape == (COUNT, 64, 64, 3)
    assert episode.metadata.calibration == native.metadata.calibration
    assert episode.metadata.regime == "play"
    assert episode.metadata.source.settings is not None
    assert episode.metadata.source.settings["parent_source_type"] == "simulated"
    assert (dataset.metadata.licence, dataset.metadata.citation) == ("CC-BY-4.0", "Doe 2026")


def open_dataset_pair(root: Path) -> tuple[Dataset, Episode]:
    with pytest.warns(match="the catalog is missing"):
        dataset = open_dataset(root)
    return dataset, dataset[0]


def test_only_tactile_streams_lose_their_colour(play: Path, tmp_path: Path) -> None:
    _, dataset = made(play, tmp_path / "train", size=64, gray=True)
    assert dataset[0]["tactile_left"].frames.shape[3] == 1
    assert dataset[0]["rgb"].frames.shape[3] == 3


def test_frames_that_are_ready_are_copied_not_coded_again(play: Path, tmp_path: Path) -> None:
    _, once = made(play, tmp_path / "once", size=64)
    _, twice = made(tmp_path / "once", tmp_path / "twice", size=64, quality=50)
    for name in ("tactile_left", "rgb"):
        again = [twice[0][name].encoded(i) for i in range(COUNT)]
        assert again == [once[0][name].encoded(i) for i in range(COUNT)]
    assert twice[0].metadata.source.lossy == once[0].metadata.source.lossy
    # Dropping colour from what is ready is another matter.
    _, grey = made(tmp_path / "once", tmp_path / "grey", size=64, gray=True)
    assert grey[0]["tactile_left"].frames.shape[3] == 1
    assert files_of(grey[0], "streams/rgb/") == files_of(once[0], "streams/rgb/")


def test_one_episode_and_a_packed_one(play: Path, tmp_path: Path) -> None:
    from exumi_data.store.pack import pack

    path = play / "episodes" / "01" / f"{PARENT}.zarr"
    packed = pack(path, tmp_path / "one.zarr.zip")
    _, folder = made(path, tmp_path / "a", size=64)
    _, archive = made(packed, tmp_path / "b", size=64)
    assert [e.digest() for e in folder] == [e.digest() for e in archive]


# ----------------------------------------------------------------------------------- runs, repeated


def test_a_second_run_skips_and_a_changed_parent_is_made_again(
    octopi: Path, labels: Path, run: Run, tmp_path: Path
) -> None:
    run(octopi, "octopi", labels=labels)
    _, dataset = made(tmp_path / "out", tmp_path / "train", size=96)
    before = {e.id: e.digest() for e in dataset}
    report, _ = made(tmp_path / "out", tmp_path / "train", size=96)
    assert (report.converted, report.skipped) == (0, 5)
    labels.write_text(labels.read_text().replace("rice,2.33", "rice,3.33"))
    run(octopi, "octopi", labels=labels)
    report, dataset = made(tmp_path / "out", tmp_path / "train", size=96)
    assert (report.converted, report.skipped) == (1, 4)
    assert set(before) == set(dataset.ids)
    (changed,) = [e for e in dataset if e.digest() != before[e.id]]
    assert changed.metadata.revision == 2
    # Every clip would be in it twice.
    with pytest.raises(UsageError, match=r"other settings: size 96 \(now 64\)"):
        prepare(tmp_path / "out", tmp_path / "train", size=64)
    assert open_dataset(tmp_path / "train").ids == dataset.ids


def test_activity_that_was_computed_anew_is_carried_anew(play: Path, tmp_path: Path) -> None:
    made(play, tmp_path / "train", size=64)
    path = play / "episodes" / "01" / f"{PARENT}.zarr"
    document = (path / "derived" / "zarr.json").read_text()
    (path / "derived" / "zarr.json").write_text(document.replace("5.83", "6.5"))
    report, dataset = made(play, tmp_path / "train", size=64)
    assert report.converted == 1
    derived = dataset[0].derived
    assert derived is not None
    assert derived.items["tactile_left/activity"].parameters["threshold"] == 6.5


def test_any_number_of_workers_gives_the_same(octopi: Path, run: Run, tmp_path: Path) -> None:
    run(octopi, "octopi")
    _, one = made(tmp_path / "out", tmp_path / "one", size=96)
    report = prepare(tmp_path / "out", tmp_path / "two", size=96, workers=2)
    assert report.converted == 5
    assert [e.digest() for e in one] == [e.digest() for e in open_dataset(tmp_path / "two")]


def test_a_damaged_parent_fails_by_name_and_the_rest_is_made(
    octopi: Path, run: Run, tmp_path: Path
) -> None:
    _, native = run(octopi, "octopi")
    places = [tmp_path / "out" / p for p in native.catalog.column("path").to_pylist()]
    shutil.rmtree(places[0] / "streams" / "tactile" / "data" / "c")
    shard = places[1] / "streams" / "tactile" / "data" / "c" / "0"
    content = bytearray(shard.read_bytes())
    middle = len(content) // 2
    content[middle - 1500 : middle + 1500] = bytes(3000)
    shard.write_bytes(content)
    (places[2] / "zarr.json").unlink()
    report = prepare(tmp_path / "out", tmp_path / "train", size=96, workers=1)
    assert (report.total, report.converted) == (5, 2)
    reasons = {failure.name: failure.reason for failure in report.failed}
    names = [place.name.partition(".")[0] for place in places[:3]]
    assert set(reasons) == set(names)
    assert "shard is missing" in reasons[names[0]]
    assert "cannot be decoded" in reasons[names[1]]
    assert "no zarr.json" in reasons[names[2]]
    assert len(open_dataset(tmp_path / "train")) == 2
    assert not list((tmp_path / "train").rglob(".partial-*"))


@pytest.mark.parametrize("size", [64, 120])
def test_activity_is_measured_where_there_is_none(play: Path, tmp_path: Path, size: int) -> None:
    path = play / "episodes" / "01" / f"{PARENT}.zarr"
    shutil.rmtree(path / "derived")
    made(play, tmp_path / "train", size=size)
    report, dataset = made(play, tmp_path / "train", size=size)
    assert (report.converted, report.skipped) == (0, 1)
    parent = open_episode(path)["tactile_left"]
    assert parent.reference is not None
    meter = ActivityMeter(parent.reference)
    expected = [meter.measure(frame[..., 0]) for frame in parent.frames.iterate(grey=True)]
    assert max(expected) > 0.01
    activity = dataset[0]["tactile_left"].activity
    assert activity is not None
    # The luma of a decoded JPEG may differ by a level from that of its colours.
    assert np.abs(activity - expected).max() < 1e-3
    derived = dataset[0].derived
    assert derived is not None
    assert list(derived.items) == ["tactile_left/activity"]
    assert derived.items["tactile_left/activity"].parameters["active_above"] == 1e-3
    assert derived.items["tactile_left/activity"].inputs[0].startswith(PARENT)


def test_activity_of_what_is_copied_is_measured_too(play: Path, tmp_path: Path) -> None:
    made(play, tmp_path / "once", size=64)
    (once,) = open_dataset(tmp_path / "once")
    shutil.rmtree(Path(once.path) / "derived")
    _, twice = made(tmp_path / "once", tmp_path / "twice", size=64)
    assert files_of(twice[0], "streams/") == files_of(once, "streams/")
    assert twice[0]["tactile_left"].activity is not None


def test_a_reference_is_selected_where_there_is_none(play: Path, tmp_path: Path) -> None:
    path = play / "episodes" / "01" / f"{PARENT}.zarr"
    shutil.rmtree(path / "derived")
    shutil.rmtree(path / "streams" / "tactile_left" / "reference")

    def forget(exumi: dict[str, Any]) -> None:
        exumi["streams"]["tactile_left"]["arrays"].remove("reference")
        del exumi["streams"]["tactile_left"]["reference"]

    edit_metadata(path, forget)
    made(play, tmp_path / "train", size=64)
    report, dataset = made(play, tmp_path / "train", size=64)
    assert (report.converted, report.skipped) == (0, 1)
    about = tactile(dataset[0], "tactile_left").reference
    assert about is not None
    assert (about.method, about.algorithm) == ("selected", "exumi-reference/1")
    assert about.frames is not None
    # Contact lasts from the first third to the second.
    assert not set(about.frames) & set(range(COUNT // 3, 2 * COUNT // 3))
    native = open_episode(path)["tactile_left"]
    chosen = reference_image(list(native.frames.read(about.frames)))
    assert np.array_equal(dataset[0]["tactile_left"].reference, resize(chosen, 64))  # type: ignore[arg-type]  # there is one
    activity = dataset[0]["tactile_left"].activity
    assert activity is not None
    assert activity[COUNT // 2] > 1e-3 > activity[0]


def test_arguments_that_make_no_sense_are_refused(play: Path, tmp_path: Path) -> None:
    for options, message in (
        ({"size": 4}, r"Invalid size \(4\)"),
        ({"quality": 0}, r"Invalid quality \(0\)"),
    ):
        with pytest.raises(UsageError, match=message):
            prepare(play, tmp_path / "train", **options)  # type: ignore[arg-type]  # that is the point
    with pytest.raises(UsageError, match="source and destination are the same"):
        prepare(play, play / ".." / "play")
    (tmp_path / "empty").mkdir()
    with pytest.raises(NotAnEpisodeError, match="neither a dataset"):
        prepare(tmp_path / "empty", tmp_path / "train")
    with pytest.raises(NotAnEpisodeError):
        prepare(tmp_path / "missing", tmp_path / "train")
    assert not (tmp_path / "train").exists()
    assert open_episode(play / "episodes" / "01" / f"{PARENT}.zarr").id == PARENT


@pytest.mark.parametrize("shape", [(120, 160, 3), (120, 160, 1), (448, 448, 3), (300, 224, 3)])
def test_shrinking_is_opencv_s_area_and_growing_is_linear(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(3)
    frame = cv2.GaussianBlur(rng.integers(0, 256, shape, dtype=np.uint8), (5, 5), 0).reshape(shape)
    for size in (64, 96, 112, 224, 600):
        shrinks = min(shape[:2]) >= size
        method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        expected = cv2.resize(frame, (size, size), interpolation=method)
        assert np.array_equal(resize(frame, size), expected.reshape(size, size, shape[2]))
