"""An episode as users hold it."""

import copy
from pathlib import Path

import numpy as np
import pytest

import exumi_data
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.store.pack import pack
from tests.exumi_data.builders import (
    FRAMES,
    clip,
    copy_of,
    edit_metadata,
    episode_id,
    jpegs,
    times,
    write_episode,
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_episode(tmp_path_factory.mktemp("episode") / "a.zarr", regime="play")


@pytest.fixture(scope="module", params=["folder", "zip"])
def episode(request: pytest.FixtureRequest, path: Path) -> Episode:
    return open_episode(path if request.param == "folder" else pack(path, overwrite=True))


def test_what_is_known_at_once(episode: Episode) -> None:
    assert episode.id == episode_id()
    assert episode.metadata.task.name == "press"
    assert episode.metadata.regime == "play"
    names = ["pose", "width", "force", "taxels", "smell", "tactile", "rgb", "gopro"]
    assert list(episode) == list(episode.streams) == names
    assert [stream.name for stream in episode.of_kind("rgb")] == ["rgb", "gopro"]
    assert episode.of_kind("audio") == []
    assert "pose" in episode
    assert "nothing" not in episode
    assert 3 not in episode
    assert episode_id() in repr(episode)
    assert repr(episode["pose"]).startswith("<pose stream 'pose'")
    with pytest.raises(TypeError):
        episode.streams["new"] = episode["pose"]  # type: ignore[index]


def test_the_arrays_of_a_stream(episode: Episode) -> None:
    for stream in episode.streams.values():
        assert len(stream) == len(stream.time) == FRAMES
        assert stream.time.dtype == np.int64
    pose, width = episode["pose"], episode["width"]
    np.testing.assert_array_equal(pose.time, times())
    assert pose.data.shape == (FRAMES, 7)
    assert pose.data.dtype == np.float64
    assert width.data.dtype == np.float32
    assert width.raw is not None
    assert width.raw.dtype == np.uint16
    assert pose.raw is pose.time_host is pose.time_device is pose.reference is None
    assert pose.sequence is not None
    assert pose.sequence.tolist() == list(range(FRAMES))
    assert pose.flags is not None
    assert pose.flags.dtype == np.uint32
    assert episode["smell"].time_device is not None
    assert episode["smell"].time_device.tolist() == (times() * 2).tolist()
    assert episode["taxels"].valid is not None
    assert episode["taxels"].valid.dtype == np.bool_
    assert not pose.is_image
    assert episode["gopro"].is_image


def test_tactile_has_a_reference_and_derived_arrays(episode: Episode) -> None:
    tactile = episode["tactile"]
    assert tactile.reference is not None
    assert tactile.reference.shape == (24, 32, 3)
    assert tactile.activity is not None
    assert tactile.activity.dtype == np.float32
    assert tactile.activity.shape == (FRAMES,)
    assert tactile.salient is not None
    assert tactile.salient.tolist() == [1, 3]
    assert episode.derived is not None
    assert episode.derived.items["tactile/activity"].algorithm == "exumi-activity/1"
    assert episode["rgb"].activity is episode["rgb"].salient is None
    assert episode.derived_array("nothing/there") is None


def test_files_and_containers(episode: Episode) -> None:
    assert [episode["tactile"].encoded(i) for i in range(-FRAMES, FRAMES)] == list(jpegs()) * 2
    for index in (FRAMES, -FRAMES - 1):
        with pytest.raises(IndexError, match=f"frame {index} of 5"):
            episode["tactile"].encoded(index)
    assert episode["gopro"].container() == clip()[0]


def test_the_duration_is_that_of_all_streams(episode: Episode) -> None:
    # From -0.05 s, where most streams begin, to 0.4 s, where the video ends.
    assert episode.duration_s == pytest.approx(0.45)


def test_wrong_requests_are_answered(episode: Episode) -> None:
    with pytest.raises(UsageError, match=r"no stream 'nothing'.*The episode has: pose, width"):
        _ = episode["nothing"]
    with pytest.raises(UsageError, match=r"has no array 'colour'.*It has: time"):
        episode["pose"].array("colour")
    with pytest.raises(UsageError, match="is of kind pose and has no frames"):
        _ = episode["pose"].frames
    with pytest.raises(UsageError, match="not stored as files of their own"):
        episode["rgb"].encoded(0)
    with pytest.raises(UsageError, match="not stored as video"):
        episode["tactile"].container()


def test_arrays_that_are_kept_cannot_be_changed_by_mistake(episode: Episode) -> None:
    with pytest.raises(ValueError, match="read-only"):
        episode["pose"].time[0] = 7


def test_an_episode_can_be_sent_to_another_process(episode: Episode) -> None:
    with copy.copy(episode) as other:
        assert other is not episode
        assert other.path == episode.path
        np.testing.assert_array_equal(other["tactile"].frames[2], episode["tactile"].frames[2])


def test_a_closed_episode_opens_again(path: Path) -> None:
    with open_episode(path) as episode:
        first = episode["tactile"].frames[0]
    np.testing.assert_array_equal(episode["tactile"].frames[0], first)


def test_a_missing_array_is_found_without_reading_data(path: Path, tmp_path: Path) -> None:
    for name in ("streams/pose/data/c/0/0", "derived/tactile/salient/c/0"):
        episode = copy_of(path, tmp_path / f"{name.count('e')}.zarr")
        open_episode(episode).check_complete()
        (episode / name).unlink()
        with pytest.raises(DamagedDataError, match=f"{name}: shard is missing"):
            open_episode(episode).check_complete()


def test_a_newer_minor_version_is_read(path: Path, tmp_path: Path) -> None:
    episode = copy_of(path, tmp_path / "a.zarr")
    edit_metadata(episode, lambda document: document.update(version="1.9", colour="red"))
    opened = exumi_data.open(episode)
    assert isinstance(opened, Episode)
    assert opened.metadata.model_extra == {"colour": "red"}
    assert len(opened["tactile"].frames) == FRAMES
