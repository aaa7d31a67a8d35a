"""exUMI → oxt → exUMI: what is not equal is what the format lists, and nothing else."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_converters.conversion import convert
from exumi_converters.converter import ConvertOptions
from exumi_converters.exporter import ExportOptions
from exumi_converters.exporting import export, plan_export
from exumi_converters.registry import find_converter, find_exporter
from exumi_converters.testing import round_trip_differences
from exumi_data.dataset import open_dataset
from tests.exumi_converters.oxt.motions import NS, motion, times, write_motions
from tests.exumi_converters.whole import write_dataset

EXPORTER, CONVERTER = find_exporter("oxt"), find_converter("oxt")
# Of an episode whose instruction is its own: the other case is tried below.
NOT_OF_WHOLE = {"task"}


def lost(dataset: Path, folder: Path, **told: str) -> frozenset[str]:
    return round_trip_differences(
        EXPORTER,
        CONVERTER,
        dataset,
        folder,
        export_options=ExportOptions(settings=told, workers=1, durable=False),
        convert_options=ConvertOptions(workers=1, durable=False),
    )


def test_an_episode_that_has_everything_loses_exactly_what_is_listed(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", seconds=0.5, tactile=2)
    assert lost(dataset, tmp_path / "round") == set(EXPORTER.loses) - NOT_OF_WHOLE
    found = plan_export(dataset, tmp_path / "never", to_format="oxt", options=ExportOptions())
    # What is announced beforehand is what is lost: names of streams stay.
    assert {loss.facet for loss in found.losses} == set(EXPORTER.loses) - NOT_OF_WHOLE


def test_an_instruction_that_repeats_the_tasks_name_is_lost_too(tmp_path: Path) -> None:
    same: dict[str, Any] = {"task": "turn", "instruction": "turn", "seconds": 0.5}
    dataset = write_motions(tmp_path / "data", same)
    assert "task" in lost(dataset, tmp_path / "round")


def test_an_episode_without_an_instruction_stays_without(tmp_path: Path) -> None:
    dataset = write_motions(tmp_path / "data", {"instruction": None, "seconds": 0.5})
    assert "task" not in lost(dataset, tmp_path / "round")


@settings(max_examples=5, deadline=None)
@given(
    seconds=st.floats(0.2, 0.7),
    pads=st.sampled_from(
        [{}, {"tactile": None}, {"tactile": "right"}, {"a": "right", "b": "left"}]
    ),
    channels=st.sampled_from([1, 3]),
    with_width=st.booleans(),
    words=st.one_of(st.none(), st.text(max_size=12)),
    told=st.sampled_from([{}, {"rate": "25"}, {"axes": "umi"}, {"side": "left"}]),
)
def test_nothing_else_is_lost(told: dict[str, str], words: str | None, **made: Any) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        dataset = write_motions(root / "data", {**made, "instruction": words})
        assert lost(dataset, root / "round", **told) <= set(EXPORTER.loses)


@pytest.mark.parametrize("axes", ["kept", "umi"])
def test_values_come_back_at_the_steps(axes: str, tmp_path: Path) -> None:
    dataset = write_motions(tmp_path / "data", {})
    told = ExportOptions(settings={"axes": axes}, workers=1, durable=False)
    export(dataset, tmp_path / "out", to_format="oxt", options=told)
    options = ConvertOptions(workers=1, durable=False)
    convert(tmp_path / "out", tmp_path / "back", from_format="oxt", options=options)
    (before,), (after,) = open_dataset(dataset), open_dataset(tmp_path / "back")
    time = after["rgb"].time
    assert set(time.tolist()) <= set(times(30.0, 2.0).tolist())  # to the nanosecond
    poses, width = motion(time)
    found = after["pose"].data
    assert np.abs(found[:, :3] - poses[:, :3]).max() < 1e-3
    cosine = np.abs(np.einsum("ij,ij->i", found[:, 3:], poses[:, 3:]))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < 0.2
    assert (np.einsum("ij,ij->i", found[1:, 3:], found[:-1, 3:]) > 0).all()
    assert np.abs(after["width"].data - width).max() < 5e-4
    pads = times(25.0, 2.0, 0.003)
    nearest = np.abs(pads[None] - time[:, None]).argmin(axis=1)
    np.testing.assert_array_equal(after["tactile_left"].frames[:][:, 0, 0, 0], nearest)
    assert after["pose"].metadata.frames == before["pose"].metadata.frames  # type: ignore[attr-defined]  # poses
    assert after.metadata.source.parent_id == before.id
    assert int(time[0]) == round(NS / 30)
