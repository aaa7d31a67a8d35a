"""The contracts that exUMI Data ships for formats, kept by this one."""

from pathlib import Path

import pytest
from acme_csv import CONVERTER, EXPORTER

from exumi_converters.testing import check_converter, check_exporter, check_round_trip
from exumi_data.demo import DemoSettings, write_play_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short simulated demonstrations."""
    folder = tmp_path_factory.mktemp("data") / "play"
    write_play_dataset(folder, DemoSettings(seconds=12, taps=2, frame_width=64), workers=1)
    return folder


def test_exporter(dataset: Path, tmp_path: Path) -> None:
    check_exporter(EXPORTER, dataset, tmp_path)


def test_converter(dataset: Path, tmp_path: Path) -> None:
    check_exporter(EXPORTER, dataset, tmp_path / "out")
    check_converter(CONVERTER, tmp_path / "out" / "first", tmp_path / "in")


def test_what_a_round_trip_loses_is_what_was_announced(dataset: Path, tmp_path: Path) -> None:
    check_round_trip(EXPORTER, CONVERTER, dataset, tmp_path)
