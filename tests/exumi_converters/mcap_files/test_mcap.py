"""MCAP, both ways: contracts, the real library reading what was written, damage, strangers."""

from pathlib import Path

import pytest

from exumi_converters.registry import find_converter, find_exporter
from exumi_converters.testing import (
    check_converter,
    check_exporter,
    check_round_trip,
    round_trip_differences,
)
from tests.exumi_converters.whole import write_dataset

EXPORTER, CONVERTER = find_exporter("mcap"), find_converter("mcap")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("whole") / "data", seconds=0.5)


def test_the_contracts(dataset: Path, tmp_path: Path) -> None:
    check_exporter(EXPORTER, dataset, tmp_path / "out")
    check_converter(CONVERTER, tmp_path / "out" / "first", tmp_path / "in")
    check_round_trip(EXPORTER, CONVERTER, dataset, tmp_path / "round")


def test_a_round_trip_loses_the_id_and_nothing_else(dataset: Path, tmp_path: Path) -> None:
    lost = round_trip_differences(EXPORTER, CONVERTER, dataset, tmp_path)
    assert lost == {"identity", "source"}
