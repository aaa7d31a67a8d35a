"""Format umi keeps the contracts of converters and exporters, and loses what it says."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from exumi_converters import ConvertOptions, ExportOptions, convert, export
from exumi_converters.registry import find_converter, find_exporter
from exumi_converters.testing import check_converter, check_exporter, round_trip_differences
from exumi_converters.zarr2_files.buffer import Buffer, open_buffer
from tests.exumi_converters.umi.buffers import make_episode, write_buffer


def test_the_converter_keeps_the_contract(buffer: Path, tmp_path: Path) -> None:
    check_converter(find_converter("umi"), buffer, tmp_path)


def test_the_exporter_keeps_the_contract(grasps: Path, tmp_path: Path) -> None:
    small = ExportOptions(settings={"size": "32"})
    check_exporter(find_exporter("umi"), grasps, tmp_path, small, name="out.zarr.zip")


def test_a_round_trip_loses_exactly_what_is_listed(everything: Path, tmp_path: Path) -> None:
    exporter = find_exporter("umi")
    lost = round_trip_differences(
        exporter,
        find_converter("umi"),
        everything,
        tmp_path,
        export_options=ExportOptions(settings={"size": "32"}, workers=1),
        convert_options=ConvertOptions(workers=1),
    )
    assert lost == set(exporter.loses)


BUFFERS = st.fixed_dictionaries(
    {
        "robots": st.integers(1, 2),
        "cameras": st.integers(1, 2),
        "tactile": st.booleans(),
        "size": st.sampled_from([16, 33]),
    }
)


@settings(
    max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    counts=st.lists(st.integers(2, 14), min_size=1, max_size=3),
    seed=st.integers(0, 2**16),
    kind=BUFFERS,
    ending=st.sampled_from([".zarr", ".zarr.zip"]),
    rows=st.sampled_from([None, 3]),
)
def test_a_buffer_comes_back_as_it_was(
    tmp_path_factory: pytest.TempPathFactory,
    counts: list[int],
    seed: int,
    kind: dict[str, Any],
    ending: str,
    rows: int | None,
) -> None:
    """Buffer, episodes, buffer: every number and every pixel of every channel."""
    folder = tmp_path_factory.mktemp("trip")
    episodes = [make_episode(count, seed + i, **kind) for i, count in enumerate(counts)]
    source = write_buffer(folder / f"in{ending}", episodes, low_dim_rows=rows)
    one = ConvertOptions(settings={"images": "lossless"}, workers=1, durable=False)
    assert convert(source, folder / "dataset", options=one).converted == len(counts)
    told = ExportOptions(settings={"images": "jpegxl-lossless", "size": "0"}, workers=1)
    export(folder / "dataset", folder / f"out{ending}", to_format="umi", options=told)
    _check_same(open_buffer(source), open_buffer(folder / f"out{ending}"))


def _check_same(before: Buffer, after: Buffer) -> None:
    assert after.ends.tolist() == before.ends.tolist()
    assert set(after.arrays) == set(before.arrays)
    stop = int(before.ends[-1])
    for name in before.arrays:
        old, new = (buffer.rows(name, 0, stop).read() for buffer in (before, after))
        assert new.dtype == old.dtype, name
        near = 2e-7 if name.endswith("rot_axis_angle") else 0
        np.testing.assert_allclose(new, old, rtol=0, atol=near, err_msg=name)
