"""What our own writers write has no findings, and what has no findings our reader reads."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack
from exumi_validators import validate
from tests.exumi_data.builders import CLOCK, metadata, write_dataset

Codes = Callable[[Path], list[str]]


def test_an_episode_with_everything(good: Path, codes: Codes) -> None:
    assert codes(good) == []


def test_it_is_looked_at_whole(good: Path) -> None:
    coverage = validate(good).coverage
    assert (coverage.streams, coverage.samples, coverage.frames) == (8, 40, 15)
    assert coverage.levels == ("document", "hierarchy", "arrays", "data")


def test_packed(episode: Path, codes: Codes) -> None:
    assert codes(pack(episode)) == []


def test_without_samples(tmp_path: Path, codes: Codes) -> None:
    with EpisodeWriter(tmp_path / "e.zarr", metadata(), durable=False) as writer:
        writer.add_stream("width", kind="width", clock=CLOCK)
    assert codes(tmp_path / "e.zarr") == ["STRM-004"]


def test_long_arrays(tmp_path: Path, codes: Codes) -> None:
    with EpisodeWriter(tmp_path / "e.zarr", metadata(), durable=False) as writer:
        width = writer.add_stream("width", kind="width", clock=CLOCK)
        for start in range(0, 100_000, 9_999):
            time = np.arange(start, min(start + 9_999, 100_000))
            width.append(time, np.full(len(time), 0.05))
    assert codes(tmp_path / "e.zarr") == []
    assert validate(tmp_path / "e.zarr").coverage.samples == 100_000


def test_a_dataset(tmp_path: Path) -> None:
    report = validate(write_dataset(tmp_path / "d", 3))
    found = {problem.code for problem in report.problems}
    assert found == {"TACT-002", "DRV-006"}, "the builder's small episodes have no reference"
    assert report.valid
    assert report.coverage.episodes == 3
