"""A dataset of gratings, an index of it, and copies of that to change."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import exumi_data
from exumi_loaders.retrieval.index import TactileIndex
from tests.exumi_loaders.retrieval.gratings import write_gratings


@pytest.fixture(autouse=True, scope="module")
def _no_power_loss() -> Iterator[None]:
    """Nothing here shows what a power loss leaves; waiting for the disk is most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _descriptor: None)
        yield


@pytest.fixture(scope="session")
def gratings(tmp_path_factory: pytest.TempPathFactory) -> exumi_data.Dataset:
    opened = exumi_data.open(write_gratings(tmp_path_factory.mktemp("gratings") / "gratings"))
    assert isinstance(opened, exumi_data.Dataset)
    return opened


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory, gratings: exumi_data.Dataset) -> Path:
    path = tmp_path_factory.mktemp("index") / "index"
    TactileIndex.build(gratings, path=path, split="mine/train")
    return path


@pytest.fixture
def index(tmp_path: Path, built: Path) -> TactileIndex:
    """An index of two clips of each part, which the test may change."""
    shutil.copytree(built, tmp_path / "index")
    return TactileIndex.open(tmp_path / "index")
