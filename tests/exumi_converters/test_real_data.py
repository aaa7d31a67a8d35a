"""Recordings of real sensors, where there are some."""

from pathlib import Path

import av
import numpy as np
import pytest

from exumi_converters import ConvertOptions, convert, prepare
from exumi_data.dataset import open_dataset
from exumi_data.model import EncodedImages, TactileStream

# Some whole ones of both rates, and those that are cut.
CLIPS = (
    "egg_0.mov",
    "rice_0.mov",
    "rice_spatula_base_0.mov",
    "apple_0.mov",
    "clothes_peg_0.mov",
    "hairbrush_handle_2.mov",
    "tv_remote_back_0.mov",
    "tv_remote_back_1.mov",
    "tv_remote_back_2.mov",
    "tv_remote_back_3.mov",
)


@pytest.fixture
def octopi(real_data: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "videos"
    folder.mkdir()
    for name in CLIPS:
        (folder / name).symlink_to(real_data.resolve() / "physiclear" / "videos" / name)
    return folder


def test_clips_of_a_gelsight_mini(octopi: Path, real_data: Path, tmp_path: Path) -> None:
    labels = real_data / "physiclear" / "labels.csv"
    report = convert(
        octopi, tmp_path / "out", from_format="octopi", options=ConvertOptions(labels=labels)
    )
    assert report.failed == ()
    assert report.converted == len(CLIPS)
    flags = {(flag.name, flag.code) for flag in report.flagged}
    assert flags >= {
        ("tv_remote_back_3.mov", "truncated"),
        ("tv_remote_back_2.mov", "short"),
        ("hairbrush_handle_2.mov", "short"),
        ("apple_0.mov", "no-labels"),
    }
    dataset = open_dataset(tmp_path / "out")
    by_key = {str(episode.metadata.source.key): episode for episode in dataset}
    assert {key: len(episode["tactile"]) for key, episode in by_key.items()} == {
        **dict.fromkeys(CLIPS, 126),
        "clothes_peg_0.mov": 50,
        "rice_spatula_base_0.mov": 50,
        "hairbrush_handle_2.mov": 106,
        "tv_remote_back_2.mov": 119,
        "tv_remote_back_3.mov": 7,
    }
    for key, episode in by_key.items():
        stream = episode["tactile"]
        assert stream.container(0) == (octopi / key).read_bytes()
        assert stream.metadata.nominal_rate == ("10/1" if len(stream) == 50 else "25/1")
        assert stream.activity is not None
        assert stream.activity.shape == stream.time.shape
        if key != "tv_remote_back_3.mov":
            # They begin or end without contact: somewhere nothing is active, somewhere much is.
            assert stream.activity.min() < 1e-3 < stream.activity.max()
    rice = by_key["rice_0.mov"].metadata.annotations
    spatula = by_key["rice_spatula_base_0.mov"].metadata.annotations
    assert rice is not None
    assert spatula is not None
    assert (rice.object_id, spatula.object_id) == ("a_scoop_of_rice", "a_rice_spatula")
    again = convert(
        octopi, tmp_path / "out", from_format="octopi", options=ConvertOptions(labels=labels)
    )
    assert (again.converted, again.skipped) == (0, len(CLIPS))


def test_grasps_of_a_gelsight_wedge(real_data: Path, tmp_path: Path) -> None:
    source = real_data / "gelsight_wedge"
    options = ConvertOptions(sensor="gelsight-wedge")
    report = convert(source, tmp_path / "out", from_format="clips", options=options)
    assert (report.failed, report.notices, report.converted) == ((), (), 21)
    for episode in open_dataset(tmp_path / "out"):
        path = source / str(episode.metadata.source.key)
        with av.open(str(path)) as container:
            packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
        stream = episode["tactile"]
        assert [stream.encoded(i) for i in range(len(stream))] == packets
        model = stream.metadata
        assert isinstance(model, TactileStream)
        assert isinstance(model.images, EncodedImages)
        assert model.images.jpeg_comment == "Lavc59.37.100"
        steps = [(step.step, step.by) for step in episode.metadata.source.lossy or []]
        assert steps[0] == ("jpeg-encode", "FFmpeg (Lavc59.37.100)")
        rows = np.genfromtxt(path.with_suffix(".csv"), delimiter=",", skip_header=1)
        assert np.array_equal(episode["force"].data[:, 0], rows[:, 1].astype(np.float32))
        assert np.array_equal(episode["width"].data, rows[:, 2].astype(np.float32))
        assert np.array_equal(episode["force"].time, stream.time)
    prepared = prepare(tmp_path / "out", tmp_path / "train", gray=True)
    assert (prepared.failed, prepared.frames) == ((), report.frames)
    for episode in open_dataset(tmp_path / "train"):
        assert episode["tactile"].frames.shape[1:] == (224, 224, 1)
        assert sorted(episode.streams) == ["force", "tactile", "width"]
