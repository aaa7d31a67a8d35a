"""Buffers and datasets that several tests read."""

from pathlib import Path

import pytest

from exumi_converters import ConvertOptions, convert
from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_converters.umi.buffers import make_episode, write_buffer
from tests.exumi_converters.umi.episodes import (
    EVERYTHING,
    add_camera,
    add_gripper,
    add_tactile,
    dataset_of,
    write_everything,
)


@pytest.fixture(scope="session")
def buffer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes of exUMI, as a zip."""
    path = tmp_path_factory.mktemp("umi") / "dataset.zarr.zip"
    return write_buffer(path, [make_episode(24, 0), make_episode(30, 1)])


@pytest.fixture(scope="session")
def converted(buffer: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, converted pixel by pixel."""
    folder = tmp_path_factory.mktemp("converted") / "dataset"
    options = ConvertOptions(settings={"images": "lossless"}, workers=1)
    assert convert(buffer, folder, from_format="umi", options=options).converted == 2
    return folder


@pytest.fixture(scope="session")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes that have all that a buffer cannot keep."""
    folder = tmp_path_factory.mktemp("everything") / "dataset"
    return dataset_of(
        folder, write_everything, write_everything, **{**EVERYTHING, "regime": "play"}
    )


@pytest.fixture(scope="session")
def grasps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes with a camera and two fingers, whose motion is known."""

    def add(writer: EpisodeWriter) -> None:
        add_gripper(writer)
        add_camera(writer)
        add_tactile(writer)

    return dataset_of(tmp_path_factory.mktemp("grasps") / "dataset", add, add)
