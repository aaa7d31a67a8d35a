"""A trimmed episode is a part of the old one, sample by sample, at the same times."""

from pathlib import Path

import numpy as np
import pytest

from exumi_data.editing.trimming import trim_episode
from exumi_data.episode import open_episode
from exumi_data.errors import UsageError
from exumi_data.model.images import VideoImages
from exumi_data.model.streams import images_of
from exumi_data.store.pack import pack
from exumi_validators import validate
from tests.exumi_data.builders import write_episode


@pytest.fixture(params=["folder", "zip"])
def episode(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = write_episode(tmp_path / "one.zarr")
    if request.param == "folder":
        return path
    return pack(path, tmp_path / "packed" / "one.zarr.zip")


def test_what_is_left_is_what_was_there(episode: Path, tmp_path: Path) -> None:
    before = open_episode(write_episode(tmp_path / "before" / "one.zarr"))
    told = trim_episode(episode, 0.04, 0.26, dry_run=True)
    with open_episode(episode) as found:
        assert found.metadata.revision == 1
    done = trim_episode(episode, 0.04, 0.26)
    assert done == told
    assert done.is_changed
    with open_episode(episode) as after:
        assert (after.metadata.revision, after.id) == (2, before.id)
        assert after.metadata.source.lossy is not None
        assert [step.step for step in after.metadata.source.lossy] == ["trim"]
        for name, stream in after.streams.items():
            old = before[name]
            if isinstance(images_of(old.metadata), VideoImages):
                assert name in done.whole
                assert len(stream) == len(old)
                continue
            inside = (old.time >= 40_000_000) & (old.time < 260_000_000)
            assert 0 < inside.sum() < len(old)
            assert done.kept[name] == (inside.sum(), len(old))
            np.testing.assert_array_equal(stream.time, old.time[inside])
            if stream.is_image:
                first = int(np.flatnonzero(inside)[0])
                np.testing.assert_array_equal(stream.frames[0], old.frames[first])
            else:
                np.testing.assert_array_equal(stream.data, old.data[inside])
            if old.activity is not None:
                assert stream.activity is not None
                np.testing.assert_array_equal(stream.activity, old.activity[inside])
            if old.salient is not None:
                assert stream.salient is not None
                assert set(old.time[old.salient]) >= set(stream.time[stream.salient])
    assert [one for one in validate(episode).problems if one.severity == "error"] == []
    assert [one.name for one in episode.parent.iterdir() if one.name.startswith(".")] == []


def test_nothing_to_cut_is_no_revision(episode: Path) -> None:
    before = episode.stat().st_ino
    done = trim_episode(episode, None, 1e6)
    assert not done.is_changed
    assert (done.revision, episode.stat().st_ino) == (1, before)


def test_nothing_left_is_refused(episode: Path) -> None:
    with pytest.raises(UsageError, match="nothing would be left") as caught:
        trim_episode(episode, 50.0, None)
    assert "from -0.050 s to" in str(caught.value)
    with pytest.raises(UsageError, match="no stretch"):
        trim_episode(episode, 2.0, 1.0)


@pytest.mark.parametrize("moment", [float("nan"), float("inf"), -1e300, 1e300])
def test_what_is_no_moment(episode: Path, moment: float) -> None:
    for ends in ((moment, None), (None, moment)):
        with pytest.raises(UsageError, match="is no moment of an episode"):
            trim_episode(episode, *ends)
