"""What a killed command left."""

from pathlib import Path

from exumi_data.leftovers import clean_leftovers, settle


def folder(path: Path, text: str) -> Path:
    path.mkdir(parents=True)
    (path / "zarr.json").write_text(text)
    return path


def test_an_episode_that_was_put_aside_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    folder(tmp_path / ".replaced-a.zarr", "old")
    assert settle(path)
    assert (path / "zarr.json").read_text() == "old"
    assert not settle(path)


def test_what_its_replacement_left_is_removed(tmp_path: Path) -> None:
    path = folder(tmp_path / "a.zarr", "new")
    folder(tmp_path / ".replaced-a.zarr", "old")
    assert not settle(path)
    assert [one.name for one in tmp_path.iterdir()] == ["a.zarr"]
    assert (path / "zarr.json").read_text() == "new"
    # What is no episode is nobody's to settle.
    kept = folder(tmp_path / ".replaced-b", "old")
    assert not settle(tmp_path / "b")
    assert not settle(Path())
    assert kept.is_dir()


def test_a_dataset_is_cleaned(tmp_path: Path) -> None:
    prefix = tmp_path / "episodes/3f"
    folder(prefix / ".replaced-a.zarr", "old")
    folder(prefix / ".partial-b", "half")
    (tmp_path / ".partial-7-catalog.parquet").write_text("half")
    assert clean_leftovers(tmp_path) == [
        "2 half-written episode(s) of an earlier run were removed",
        "1 episode(s) that an earlier run had put aside were brought back",
    ]
    assert [path.name for path in prefix.iterdir()] == ["a.zarr"]
    assert clean_leftovers(tmp_path) == []
