"""With `decode` the frames are stored, and what that loses is stated."""

from pathlib import Path

import numpy as np
import pytest

from exumi_converters.exumi_session import ExumiSessionConverter
from exumi_converters.registry import find_converter
from exumi_converters.testing import check_converter
from exumi_data.dataset import Dataset
from exumi_data.simulation.hub_session import HubSession
from exumi_validators import validate
from tests.exumi_converters.exumi_session.conftest import Converted, run


@pytest.fixture(scope="module")
def decoded(small_original: HubSession, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    out = tmp_path_factory.mktemp("decoded") / "out"
    return run(small_original.root, out, decode="yes")[1]


def test_decoded_frames(small_converted: Converted, decoded: Dataset) -> None:
    _, kept = small_converted
    for episode in decoded:
        before = kept[episode.id]
        assert before.id == episode.id
        steps = {(step.step, step.stream) for step in episode.metadata.source.lossy or []}
        for name in ("rgb", "tactile_left", "tactile_right"):
            stream, old = episode[name], before[name]
            assert stream.metadata.images.encoding == "encoded"  # type: ignore[attr-defined]  # frames
            assert {("video-encode", name), ("jpeg-encode", name)} <= steps
            rows = np.searchsorted(old.time, stream.time)
            assert (np.asarray(old.time)[rows] == np.asarray(stream.time)).all()
            away = np.abs(stream.frames[7].astype(int) - old.frames[int(rows[7])])
            assert away.mean() < 2.0
        for name in ("tactile_left", "tactile_right"):
            stream = episode[name]
            assert len(np.asarray(stream.activity)) == len(stream)
            # What the hub wrote twice is there once, beside a gap.
            repeated = np.flatnonzero(np.diff(before[name].array("time_host")) == 0)
            inside = np.isin(before[name].array("time_host")[repeated], stream.array("time_host"))
            gaps = [gap.after for gap in stream.metadata.gaps or []]
            assert len(gaps) >= np.count_nonzero(inside[1:-1])
            assert (np.diff(stream.array("time_host")) > 0).all()
        assert len(episode["rgb"]) == len(before["rgb"])


def test_decoded_sessions_are_valid(decoded: Dataset) -> None:
    report = validate(decoded.path)
    # The simulated hand holds on to things for longer than people do.
    assert {problem.code for problem in report.problems} <= {"TACT-005"}


def test_the_contract(small: HubSession, tmp_path: Path) -> None:
    converter = find_converter("exumi-session")
    assert isinstance(converter, ExumiSessionConverter)
    check_converter(converter, small.root, tmp_path / "contract")
