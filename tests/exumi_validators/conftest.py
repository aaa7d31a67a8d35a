"""Episodes that are known to be valid, to be spoiled."""

from collections.abc import Callable
from pathlib import Path

import pytest

from exumi_validators import Report, validate
from tests.exumi_data.builders import copy_of, write_episode


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An episode with everything, which no test may change."""
    return write_episode(tmp_path_factory.mktemp("good") / "episode.zarr")


@pytest.fixture
def episode(good: Path, tmp_path: Path) -> Path:
    """A copy of it that a test may spoil."""
    return copy_of(good, tmp_path / "episode.zarr")


@pytest.fixture
def codes() -> Callable[[Path], list[str]]:
    """The codes that a validation finds, having found nothing that it could not check."""

    def find(path: Path) -> list[str]:
        report: Report = validate(path)
        assert report.coverage.unchecked == ()
        return sorted(problem.code for problem in report.problems)

    return find
