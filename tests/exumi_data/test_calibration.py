"""Calibration items that the standard defines: written, read, refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.calibration import (
    add_intrinsics,
    add_rectification,
    intrinsics_of,
    rectification_of,
)
from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError, MetadataError, UsageError
from exumi_data.model.calibration import Intrinsics
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile.rectification import PixelMap
from tests.exumi_data.builders import HEIGHT, WIDTH, add_images, edit_metadata, metadata

Change = Callable[[dict[str, Any]], object]
CAMERA = Intrinsics(
    model="fisheye", width=WIDTH, height=HEIGHT, fx=9.0, fy=9.5, cx=1, cy=2, distortion=[0.1] * 4
)
MAP = PixelMap(
    np.moveaxis(np.mgrid[:HEIGHT, :WIDTH], 0, -1).astype(np.uint16)[::-1].copy(),
    (HEIGHT / 2, WIDTH / 2),
    (4, 6),
    (0.05, 0.06),
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "e.zarr"
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        add_images(writer)
        add_rectification(writer, "tactile", MAP, method="a grid of dots", residual=0.5)
        add_intrinsics(writer, "gopro", CAMERA, method="a board", residual=0.3)
    return path


def test_what_was_added_is_read_again(path: Path) -> None:
    with open_episode(path) as episode:
        found = rectification_of(episode, "tactile")
        assert found is not None
        assert np.array_equal(found.index, MAP.index)
        assert (found.crop, found.mm_per_px) == (MAP.crop, MAP.mm_per_px)
        assert intrinsics_of(episode, "gopro") == CAMERA
        item = episode.metadata.calibration["intrinsics/gopro"]
        assert (item.unit, item.method, item.residual) == ("px", "a board", 0.3)
        assert rectification_of(episode, "gopro") is None
        assert intrinsics_of(episode, "tactile") is None
        array = episode.calibration_array("rectification/tactile", shape=MAP.index.shape)
        assert array.dtype == np.uint16


def item(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda exumi: exumi["calibration"][name]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            lambda e: item("intrinsics/gopro")(e)["value"].update(width=7),
            MetadataError,
            "holds for images of 7x",
        ),
        (
            lambda e: item("intrinsics/gopro")(e)["value"].pop("fx"),
            MetadataError,
            r"@ \$.calibration.*intrinsics/gopro.*value",
        ),
        (
            lambda e: item("intrinsics/gopro")(e).update(value=[[1, 0], [0, 1]]),
            MetadataError,
            "intrinsics/gopro",
        ),
        (
            lambda e: item("rectification/tactile")(e).update(value=None),
            MetadataError,
            "rectification/tactile",
        ),
        (
            lambda e: item("rectification/tactile")(e)["value"].update(crop_px=[HEIGHT + 1, 2]),
            DamagedDataError,
            "outside of the map",
        ),
        (
            lambda e: item("rectification/tactile")(e).update(array="calibration/nowhere"),
            DamagedDataError,
            "nowhere",
        ),
        (
            lambda e: item("rectification/tactile")(e).update(array="streams/tactile/time"),
            DamagedDataError,
            "no array below calibration",
        ),
        (
            lambda e: item("rectification/tactile")(e).update(array="calibration/../streams"),
            DamagedDataError,
            "no array below calibration",
        ),
        (lambda e: item("rectification/tactile")(e).pop("array"), UsageError, "no calibration"),
    ],
)
def test_items_that_do_not_fit_are_refused(
    path: Path, change: Change, error: type[Exception], message: str
) -> None:
    edit_metadata(path, change)
    with open_episode(path) as episode, pytest.raises(error, match=message):
        _ = intrinsics_of(episode, "gopro"), rectification_of(episode, "tactile")


def test_an_array_of_another_shape_is_not_read(path: Path) -> None:
    with open_episode(path) as episode:
        with pytest.raises(DamagedDataError, match=r"expected \(3, 3\)"):
            episode.calibration_array("rectification/tactile", shape=(3, 3))
        with pytest.raises(UsageError, match="no calibration array of 'intrinsics/gopro'"):
            episode.calibration_array("intrinsics/gopro")


NAMES = ("deep/er/map", "rectification/other", "rectification/tactile")


@pytest.mark.parametrize("left_out", [NAMES[:0], NAMES[:1], NAMES[1:2], NAMES[1:], NAMES])
def test_a_group_is_copied_without_some_arrays(tmp_path: Path, left_out: tuple[str, ...]) -> None:
    with EpisodeWriter(tmp_path / "a.zarr", metadata(), durable=False) as writer:
        for name in NAMES:
            writer.add_calibration_array(name, MAP.index)
    with (
        open_episode(tmp_path / "a.zarr") as parent,
        EpisodeWriter(tmp_path / "b.zarr", metadata(), durable=False) as writer,
    ):
        writer.copy_group(parent, "calibration", without=[f"calibration/{n}" for n in left_out])
    root = tmp_path / "b.zarr" / "calibration"
    copied = {path.parent.relative_to(root).as_posix() for path in root.rglob("c")}
    assert copied == set(NAMES) - set(left_out)
    # No group is left that holds nothing.
    folders = [path.parent for path in root.rglob("zarr.json")]
    assert all(any(folder.rglob("c")) for folder in folders)
    assert root.exists() == bool(copied)
