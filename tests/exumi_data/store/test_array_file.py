"""Large video files are read where they are needed; their frames are those of files read whole."""

from pathlib import Path

import numpy as np
import pytest

import exumi_data
from exumi_data.store import images
from exumi_data.store.array_file import open_bytes
from exumi_data.store.shards import open_array
from tests.exumi_data.builders import write_episode


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> exumi_data.Episode:
    path = write_episode(tmp_path_factory.mktemp("video") / "a.zarr")
    opened = exumi_data.open(path)
    assert isinstance(opened, exumi_data.Episode)
    return opened


def test_bytes_of_an_array_are_a_file(episode: exumi_data.Episode) -> None:
    whole = episode["gopro"].container()
    array = open_array(episode.store, "streams/gopro/data")
    with open_bytes(array, 3, len(whole) - 5) as file:
        assert file.read() == whole[3:-5]
        assert file.seek(-4, 2) == len(whole) - 12
        assert file.read(100) == whole[-9:-5]
        assert file.read(1) == b""
        assert file.seek(10) == 10
        assert file.read(4) == whole[13:17]
        with pytest.raises(OSError, match="no such place"):
            file.seek(-len(whole), 2)


def test_frames_are_the_same(episode: exumi_data.Episode, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = episode["gopro"].frames[:]
    monkeypatch.setattr(images, "_WHOLE_VIDEO_BYTES", 0)
    again = exumi_data.open(Path(episode.path))
    assert isinstance(again, exumi_data.Episode)
    np.testing.assert_array_equal(again["gopro"].frames[:], whole)
    np.testing.assert_array_equal(again["gopro"].frames[2], whole[2])
