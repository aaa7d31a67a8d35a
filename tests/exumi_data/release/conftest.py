"""A dataset that may be released, and releases of it."""

from pathlib import Path

import pytest

from exumi_data.cli.release_judge import judge_with
from exumi_data.release.building import Built, build_release
from tests.exumi_data.builders import write_dataset
from tests.exumi_data.release.making import Release, planned


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Three small episodes, with the text of their licence."""
    root = write_dataset(tmp_path / "my-dataset")
    (root / "LICENSE").write_text("Do with it what you like.\n")
    return root


@pytest.fixture
def release() -> Release:
    """Make a release."""

    def make(source: Path, target: Path, *, workers: int = 1, **wishes: object) -> Built:
        plan = planned(source, target, **wishes)
        assert not plan.problems
        return build_release(plan, judge_with(1), workers=workers)

    return make
