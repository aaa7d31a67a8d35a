"""The training example runs as it stands, and learns."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from exumi_data.demo import DemoSettings, write_play_dataset

EXAMPLE = Path(__file__).parents[2] / "examples" / "train_tpp.py"


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("play") / "dataset"
    write_play_dataset(root, DemoSettings(seconds=6), workers=1)
    return root


def test_the_loss_falls(play: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLE), str(play), "--steps", "21"],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    losses = [float(value) for value in re.findall(r"loss (\S+)", done.stdout)]
    assert len(losses) == 3
    assert losses[-1] < losses[0]
    assert "of them active" in done.stdout


def test_one_episode_is_refused(play: Path) -> None:
    (episode, *_) = sorted(play.glob("episodes/*/*.zarr"))
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), str(episode)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 2
    assert "give a dataset" in done.stderr
