"""Rules of sound, on both sides of their limits."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.store.episode_writer import EpisodeWriter
from exumi_validators import validate
from tests.exumi_data.builders import CLOCK, metadata

RATE = 8000
BLOCK = 80


def judged(path: Path, times: np.ndarray, *, rate: str = str(RATE)) -> tuple[set[str], set[str]]:
    """Write sound whose blocks come at some times; return rules broken, and rules not judged."""
    blocks = [np.full((BLOCK, 1), i % 100, np.int16) for i in range(len(times))]
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        stream = writer.add_stream("sound", kind="audio", clock=CLOCK, rate=rate, channels=1)
        stream.append(times, blocks)
    report: Any = validate(path, levels=("document", "hierarchy", "arrays"))
    found = {problem.code for problem in report.problems}
    return found, {skipped.code for skipped in report.coverage.skipped}


def regular(count: int, factor: float = 1.0) -> np.ndarray:
    return np.round(np.arange(count) * (BLOCK / RATE * 1e9 * factor)).astype(np.int64)


@pytest.mark.parametrize(("factor", "wrong"), [(1.019, False), (1.021, True), (0.5, True)])
def test_a_rate_that_is_not_the_stated_one(tmp_path: Path, factor: float, wrong: bool) -> None:
    found, skipped = judged(tmp_path / "a.zarr", regular(600, factor))
    assert ("AUD-002" in found) == wrong
    assert "AUD-002" not in skipped


def test_lost_blocks_do_not_change_the_rate(tmp_path: Path) -> None:
    times = np.delete(regular(600), np.arange(100, 160))
    found, _ = judged(tmp_path / "a.zarr", times)
    assert "AUD-002" not in found


def test_stamps_may_jitter(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 1e6, 600).clip(-4e6, 4e6).astype(np.int64)
    assert "AUD-002" not in judged(tmp_path / "a.zarr", np.sort(regular(600) + noise))[0]


@pytest.mark.parametrize(("count", "skips"), [(201, False), (200, True)])
def test_too_little_sound_is_not_judged(tmp_path: Path, count: int, skips: bool) -> None:
    found, skipped = judged(tmp_path / "a.zarr", regular(count), rate="4000")
    assert ("AUD-002" in skipped) == skips
    assert ("AUD-002" in found) != skips
