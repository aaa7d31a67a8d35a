"""The checks keep the contract of exUMI Data, and find what they are for."""

from pathlib import Path
from typing import Literal

import acme_house_rules
import numpy as np

from exumi_data import EpisodeWriter
from exumi_data.model import Clock, EpisodeMetadata, Source, Task
from exumi_validators import validate
from exumi_validators.testing import check_checks

Regime = Literal["demonstration", "play"]


def episode(
    path: Path, task: str, *, success: bool | None, regime: Regime = "demonstration"
) -> Path:
    metadata = EpisodeMetadata(
        id="0198f0a0-0000-7000-8000-000000000001",
        task=Task(name=task),
        regime=regime,
        licence="CC-BY-4.0",
        source=Source(type="recorded", tool="acme", tool_version="1"),
    )
    if success is not None:  # what is not known is left out
        metadata.success = success
    with EpisodeWriter(path, metadata, durable=False) as writer:
        clock = Clock(source="hub", stamp_point="user_rx")
        width = writer.add_stream("width", kind="width", clock=clock)
        for number in range(40):
            width.append(10_000_000 * number, np.float32(0.001 * number))
    return path


def test_the_checks_keep_the_contract(tmp_path: Path) -> None:
    good = episode(tmp_path / "good.zarr", "open the jar", success=True)
    play = episode(tmp_path / "play.zarr", "stack the cups", success=None, regime="play")
    typing = episode(tmp_path / "typing.zarr", "open teh jar", success=False)
    unrated = episode(tmp_path / "unrated.zarr", "open the jar", success=None)
    bad = {typing: {"acme:TASK-001": 1}, unrated: {"acme:TASK-002": 1}}
    check_checks(acme_house_rules, good=[good, play], bad=bad)


def test_play_is_passed_over_and_counted(tmp_path: Path) -> None:
    report = validate(episode(tmp_path / "p.zarr", "stack the cups", success=None, regime="play"))
    assert "acme:TASK-002" in {item.code for item in report.coverage.skipped}
