"""The timeline cache: used when nothing changed, never when something did."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exumi_data
from exumi_data.catalog import build_catalog, write_catalog
from exumi_loaders import TPPWindows


def entries(cache: Path) -> set[str]:
    return {path.name for path in cache.iterdir()} if cache.exists() else set()


def test_second_opening_reads_no_episode(
    make_dataset: Any, recipe: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = make_dataset(recipe(tactile_s=np.arange(90) / 30, activity=np.zeros(90)))
    cache = tmp_path / "cache"
    first = TPPWindows(dataset, cache=cache)
    (folder,) = entries(cache)
    assert not folder.startswith(".")

    def fail(*_: object, **__: object) -> None:
        pytest.fail("an episode was read although the timeline is cached")

    monkeypatch.setattr("exumi_loaders.timeline.open_stores", fail)
    second = TPPWindows(dataset, cache=cache)
    np.testing.assert_array_equal(first.timeline.frame["tactile"], second.timeline.frame["tactile"])
    assert first.layout == second.layout
    assert first.timeline.edges.tolist() == second.timeline.edges.tolist()


def test_settings_and_content_are_in_the_key(
    make_dataset: Any, recipe: Any, tmp_path: Path
) -> None:
    cache = tmp_path / "cache"
    dataset = make_dataset(recipe(tactile_s=np.arange(90) / 30))
    TPPWindows(dataset, cache=cache)
    TPPWindows(dataset, cache=cache, tick_s=0.1)
    TPPWindows(dataset, cache=cache, active_above=0.5)
    assert len(entries(cache)) == 3
    changed = make_dataset(recipe(tactile_s=np.arange(60) / 30))
    windows = TPPWindows(changed, cache=cache)
    assert len(entries(cache)) == 4
    assert windows.timeline.ticks == 40


def test_changed_activity_is_noticed(make_dataset: Any, recipe: Any, tmp_path: Path) -> None:
    time = np.arange(90) / 30
    before = make_dataset(recipe(tactile_s=time, activity=np.zeros(90)))
    assert not TPPWindows(before, cache=tmp_path / "cache").active.any()
    after = make_dataset(recipe(tactile_s=time, activity=np.ones(90)))
    assert TPPWindows(after, cache=tmp_path / "cache").active.all()


def test_a_damaged_cache_is_computed_anew(make_dataset: Any, recipe: Any, tmp_path: Path) -> None:
    dataset = make_dataset(recipe(tactile_s=np.arange(90) / 30))
    cache = tmp_path / "cache"
    TPPWindows(dataset, cache=cache)
    (folder,) = cache.iterdir()
    (folder / "edges.npy").write_bytes(b"\x93NUMPY")
    assert len(TPPWindows(dataset, cache=cache)) == 60


def test_a_cache_that_cannot_be_written_is_no_error(
    make_dataset: Any, recipe: Any, tmp_path: Path
) -> None:
    dataset = make_dataset(recipe(tactile_s=np.arange(90) / 30))
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert len(TPPWindows(dataset, cache=blocked / "cache")) == 60


def test_the_dataset_folder_is_never_written(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(recipe(tactile_s=np.arange(90) / 30))
    before = sorted(str(path) for path in Path(dataset.path).rglob("*"))
    windows = TPPWindows(dataset)
    _ = windows[0]
    assert sorted(str(path) for path in Path(dataset.path).rglob("*")) == before


def test_catalog_of_a_selection(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(*(recipe(tactile_s=np.arange(90) / 30) for _ in range(3)))
    table, _ = build_catalog(Path(dataset.path))
    write_catalog(Path(dataset.path), table)
    opened = exumi_data.open(dataset.path)
    assert isinstance(opened, exumi_data.Dataset)
    assert len({opened[:2].fingerprint, opened[1:].fingerprint, opened.fingerprint}) == 3


def test_workers_and_pieces_do_not_show(
    make_dataset: Any, recipe: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = make_dataset(*(recipe(tactile_s=np.arange(60 + n) / 30) for n in range(5)))
    alone = TPPWindows(dataset, cache=False).timeline
    monkeypatch.setattr("exumi_loaders.timeline._MANY_EPISODES", 5)
    monkeypatch.setattr("exumi_loaders.timeline._PIECE", 2)
    shared = TPPWindows(dataset, cache=False).timeline
    assert alone.edges.tolist() == shared.edges.tolist()
    np.testing.assert_array_equal(alone.roots, shared.roots)
    np.testing.assert_array_equal(alone.frame["tactile"], shared.frame["tactile"])
