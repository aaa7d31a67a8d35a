"""Values of samples that are flagged `invalid` break no rule."""

from pathlib import Path

import numpy as np
import pytest

from exumi_data.model import Embodiment, Frames, RawData
from exumi_data.standard import flags
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_validators import validate
from tests.exumi_data.builders import CLOCK, metadata

CODES = {"POSE-001", "POSE-002", "RAW-003", "WIDTH-001", "WIDTH-002"}


@pytest.mark.parametrize("told", [False, True])
def test_what_is_said_to_be_invalid_is_not_judged(tmp_path: Path, told: bool) -> None:
    time = np.arange(9, dtype=np.int64) * 10_000_000
    bits = np.zeros(9, np.uint32)
    bits[[2, 4, 6]] = flags()["invalid"].mask if told else 0
    poses = np.tile(np.array([0, 0, 0, 0, 0, 0, 1.0]), (9, 1))
    poses[2, 6], poses[4, 6] = 1.1, -1.0
    widths = np.full(9, 0.04, np.float32)
    widths[2], widths[4] = -0.01, 0.2
    counts = np.full(9, 100, np.int32)
    counts[6] = 4096
    gripper = Embodiment(name="gripper", max_width_m=0.1)
    path = tmp_path / "e.zarr"
    with EpisodeWriter(path, metadata(embodiment=gripper), durable=False) as writer:
        frames = Frames(parent="world", child="gripper")
        writer.add_stream("pose", kind="pose", clock=CLOCK, frames=frames).append(
            time, poses, flags=bits
        )
        raw = RawData(unit="count", modulus=4096)
        writer.add_stream("width", kind="width", clock=CLOCK, raw=raw).append(
            time, widths, raw=counts, flags=bits
        )
    assert CODES & set(validate(path).codes()) == (set() if told else CODES)
