"""A dataset is taken up by one command at a time, and its catalog is kept true."""

from pathlib import Path

import pytest

from exumi_data.catalog import CATALOG_NAME, episode_path, read_catalog
from exumi_data.destination import is_current, only_run, take_up, update_catalog
from exumi_data.errors import UsageError
from exumi_data.model import DatasetMetadata
from tests.exumi_data.builders import edit_metadata, episode_id, write_dataset

METADATA = DatasetMetadata(name="set", licence="CC0-1.0")


def rows(root: Path) -> dict[str, dict[str, object]]:
    table = read_catalog(root)
    assert table is not None
    return {row["path"]: row for row in table.to_pylist()}


def test_a_dataset_is_made_and_taken_up(tmp_path: Path) -> None:
    root = take_up(tmp_path / "a" / "set", METADATA)
    before = (root / "dataset.json").read_bytes()
    assert (root / "episodes").is_dir()
    (root / "episodes").rmdir()
    assert take_up(root, DatasetMetadata(name="other", licence="MIT")) == root
    assert (root / "episodes").is_dir()
    assert (root / "dataset.json").read_bytes() == before
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot be made"):
        take_up(tmp_path / "file" / "set", METADATA)


def test_one_run_at_a_time(tmp_path: Path) -> None:
    with (
        only_run(tmp_path),
        pytest.raises(UsageError, match="another command is writing"),
        only_run(tmp_path),
    ):
        pass
    with only_run(tmp_path):
        assert list(tmp_path.iterdir()) == []


def test_only_what_is_not_known_is_read(tmp_path: Path) -> None:
    root = tmp_path / "set"
    write_dataset(root, 3)
    assert update_catalog(root, {}) == []
    whole = rows(root)
    assert len(whole) == 3
    stamp = (root / CATALOG_NAME).stat().st_mtime_ns
    assert update_catalog(root, whole) == []
    assert (root / CATALOG_NAME).stat().st_mtime_ns == stamp, "nothing was to be written"
    first, second, third = whole
    known = {first: {**whole[first], "revision": 7}, "episodes/gone.zarr": whole[first]}
    (root / third / "zarr.json").write_bytes(b"{")
    (problem,) = update_catalog(root, known)
    assert Path(third).name in problem
    assert rows(root) == {first: known[first], second: whole[second]}


def test_an_episode_is_current_while_its_documents_are(tmp_path: Path) -> None:
    root = tmp_path / "set"
    write_dataset(root, 1)
    update_catalog(root, {})
    ((path, row),) = rows(root).items()
    assert path == episode_path(episode_id(0))
    assert is_current(root / path, row)
    assert not is_current(root / path, {**row, "derived_digest": None})
    edit_metadata(root / path / "derived", lambda document: document.update(weather="rain"))
    assert not is_current(root / path, row)
    assert not is_current(root / "episodes/gone.zarr", row)
