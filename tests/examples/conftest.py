"""A play session to train on, and the examples' own modules."""

import sys
from pathlib import Path

import pytest

from exumi_data.demo import DemoSettings, write_play_dataset

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))


@pytest.fixture(scope="session")
def play(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two grasps, small and with taps."""
    root = tmp_path_factory.mktemp("play") / "dataset"
    write_play_dataset(root, DemoSettings(seconds=12, taps=2, frame_width=64), workers=1)
    return root
