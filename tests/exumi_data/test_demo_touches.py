"""The dataset of simulated touches: made again it is the same, and nothing is wrong with it."""

from pathlib import Path

import pytest

import exumi_data
from exumi_data.demo import TouchSettings, write_touch_dataset
from exumi_data.errors import UsageError
from exumi_validators import validate


def test_it_is_the_same_again_and_valid(tmp_path: Path) -> None:
    settings = TouchSettings(parts=2, clips=2)
    made = [write_touch_dataset(tmp_path / name, settings, workers=1) for name in ("a", "b")]
    assert made[0].ids == made[1].ids
    assert len(made[0]) == 4
    for one, other in zip(*made, strict=True):
        assert isinstance(one, exumi_data.Episode)
        assert (one["tactile"].frames[5] == other["tactile"].frames[5]).all()
        about = one.metadata.annotations
        assert about is not None
        assert (about.part_id, about.procedure) == (about.object_id, "press")
        assert len(one["tactile"].frames) == 14
    report = validate(tmp_path / "a", workers=1)
    assert report.problems == ()
    with pytest.raises(UsageError, match="positive"):
        write_touch_dataset(tmp_path / "c", TouchSettings(clips=0))
    assert not (tmp_path / "c").exists()
