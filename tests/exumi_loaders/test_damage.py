"""Damaged data in the middle of an epoch, and datasets that change while they are read."""

import copy
import os
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import exumi_data
from exumi_data.catalog import build_catalog, write_catalog
from exumi_data.dataset import open_dataset
from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_data.store.pack import pack
from exumi_loaders import TPPWindows

FRAME = 60  # the damaged one: at 2 s, tick 40


def seconds(rate: float, duration: float = 6.0) -> np.ndarray:
    return np.arange(round(rate * duration)) / rate


def full(recipe: Any, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "tactile_s": seconds(30),
        "rgb_s": seconds(30),
        "activity": np.repeat([0.0, 0.01, 0.0], 60),
        "encoded": True,
    }
    return recipe(**{**values, **changes})


def open_windows(dataset: exumi_data.Dataset, **options: Any) -> TPPWindows:
    options = {"tick_s": Fraction(1, 20), "cache": False, "random_history": False, **options}
    return TPPWindows(dataset, **options)


def damage(dataset: exumi_data.Dataset, stream: str = "tactile", frame: int = FRAME) -> None:
    with dataset[0] as episode:
        start = int(np.asarray(episode[stream]._frame_source.offset)[frame])  # type: ignore[attr-defined]
    file = Path(dataset.episode_location(0), f"streams/{stream}/data/c/0")
    with file.open("r+b") as opened:
        opened.seek(start + 20)
        opened.write(b"\xff" * 8)


def windows_with(windows: TPPWindows, stream: str, frame: int) -> np.ndarray:
    """Windows that read a frame, by the timeline alone."""
    steps = np.array([-12, -8, -4, 0, 4, 8, 12, 16]) if stream == "tactile" else np.array([0])
    ticks = np.clip(np.arange(len(windows))[:, None] + steps, 0, len(windows) - 1)
    return np.asarray((windows.timeline.frame[stream][ticks] == frame).any(axis=1))


def test_by_default_the_frame_is_named(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    damage(dataset)
    windows = open_windows(dataset)
    bad = windows_with(windows, "tactile", FRAME)
    assert 0 < bad.sum() < len(windows)
    for index in np.flatnonzero(~bad)[:5].tolist():
        assert windows[index]["tactile_valid"].all()
    with pytest.raises(DamagedDataError) as caught:
        windows.__getitems__([int(np.flatnonzero(bad)[0])])
    assert caught.value.where is not None
    assert caught.value.where.endswith(f"stream tactile, frame {FRAME}")
    assert dataset.ids[0] in caught.value.where
    assert not isinstance(caught.value, ChangedDataError)


def test_the_frame_is_named_out_of_a_worker(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    damage(dataset)
    with pytest.raises(DamagedDataError, match=f"stream tactile, frame {FRAME}"):
        list(open_windows(dataset).loader(16, num_workers=1))


def test_substituted_frames_are_black_and_counted(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    indices = list(range(120))
    before = open_windows(dataset).__getitems__(indices)
    damage(dataset)
    windows = open_windows(dataset, on_corrupt="substitute")
    batch = windows.__getitems__(indices)
    bad = windows_with(windows, "tactile", FRAME)
    np.testing.assert_array_equal(batch["substituted"] > 0, bad)
    np.testing.assert_array_equal((~batch["tactile_valid"]).sum(dim=1), batch["substituted"])
    np.testing.assert_array_equal(batch["valid"], before["valid"].numpy() & ~bad)
    sound = batch["tactile_valid"]
    assert torch.equal(batch["tactile"][sound], before["tactile"][sound])
    assert not batch["tactile"][~sound].any()
    assert torch.equal(batch["tactile_reference"], before["tactile_reference"])
    assert torch.equal(batch["rgb"], before["rgb"])


@pytest.mark.parametrize("workers", [0, 2])
def test_skipped_windows_are_replaced_by_others_as_active(
    make_dataset: Any, recipe: Any, workers: int
) -> None:
    dataset = make_dataset(full(recipe))
    damage(dataset)
    damage(dataset, "rgb", 150)
    windows = open_windows(dataset, on_corrupt="skip")
    bad = windows_with(windows, "tactile", FRAME) | windows_with(windows, "rgb", 150)
    active = windows.active
    sizes, replaced = [], 0
    for number, batch in enumerate(windows.loader(16, shuffle=False, num_workers=workers)):
        sizes.append(len(batch["valid"]))
        asked = np.arange(number * 16, min(number * 16 + 16, 120))
        np.testing.assert_array_equal(batch["replaced"] > 0, bad[asked])
        got = np.round(batch["time_ns"].numpy() / 50e6).astype(int)
        np.testing.assert_array_equal(got[~bad[asked]], asked[~bad[asked]])
        assert not bad[got].any()
        np.testing.assert_array_equal(active[got], active[asked])
        assert batch["tactile_valid"].all()
        for row, index in enumerate(got):  # the whole item is that of the other window
            item = windows[int(index)]
            for key in ("tactile", "rgb", "tactile_steps", "padding", "valid"):
                assert torch.equal(batch[key][row], item[key]), key
        replaced += int((batch["replaced"] > 0).sum())
    assert sizes == [16] * 7 + [8]
    assert replaced == bad.sum() > 0
    again = windows.__getitems__(np.flatnonzero(bad).tolist())
    assert torch.equal(
        again["time_ns"], windows.__getitems__(np.flatnonzero(bad).tolist())["time_ns"]
    )


def test_when_all_is_damaged_skipping_ends(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    Path(dataset.episode_location(0), "streams/tactile/data/c/0").unlink()
    with pytest.raises(DamagedDataError, match="drawn to replace it"):
        open_windows(dataset, on_corrupt="skip")[0]
    batch = open_windows(dataset, on_corrupt="substitute").__getitems__([3, 50])
    assert batch["substituted"].tolist() == [8, 8]
    assert not batch["tactile"].any()
    assert batch["rgb_valid"].all()


def test_a_damaged_reference_takes_its_stream_along(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    shutil.rmtree(Path(dataset.episode_location(0), "streams/tactile/reference"))
    with pytest.raises(DamagedDataError, match="reference"):
        open_windows(dataset)[40]
    item = open_windows(dataset, on_corrupt="substitute")[40]
    assert not item["tactile_valid"].any()
    assert not item["tactile_reference"].any()
    assert item["rgb_valid"].all()


@pytest.mark.parametrize("policy", ["raise", "skip", "substitute"])
@pytest.mark.parametrize("encoded", [True, False])
def test_another_revision_is_never_read_by_mistake(
    make_dataset: Any, recipe: Any, rewrite: Any, policy: Any, encoded: bool
) -> None:
    dataset = make_dataset(full(recipe, encoded=encoded))
    windows = open_windows(dataset, on_corrupt=policy)
    before = windows[40]
    root = Path(dataset.path)
    # The same shapes, other pixels: nothing but its identity tells it.
    rewrite(root, 0, full(recipe, encoded=encoded, shift=50, revision=2))
    for reader in (windows, open_windows_again(windows)):
        try:
            item = reader[40]
        except ChangedDataError as error:
            assert dataset.ids[0] in str(error)  # noqa: PT017  # what is there is as it was, or this
        else:
            assert torch.equal(item["tactile"], before["tactile"])
    with pytest.raises(ChangedDataError, match=r"another revision.*exumi index"):
        open_windows_again(windows)[40]


def open_windows_again(windows: TPPWindows) -> TPPWindows:
    """As another process gets it."""
    return copy.deepcopy(windows)


def test_a_stale_catalog_is_no_reason_to_read_the_wrong_frames(
    make_dataset: Any, recipe: Any, rewrite: Any, tmp_path: Path
) -> None:
    dataset = make_dataset(full(recipe))
    open_windows(dataset, cache=tmp_path / "cache")
    root = Path(dataset.path)
    rewrite(root, 0, full(recipe, tactile_s=seconds(20), activity=np.zeros(120), revision=2))
    stale = open_windows(open_dataset(root), cache=tmp_path / "cache")
    with pytest.raises(ChangedDataError):
        stale[40]
    table, _ = build_catalog(root)
    write_catalog(root, table)
    fresh = open_windows(open_dataset(root), cache=tmp_path / "cache")
    assert int(fresh[40]["tactile"][3, 0, 0, 0]) == pytest.approx(40, abs=1)


@pytest.mark.parametrize("encoded", [True, False])
def test_files_that_vanish_shrink_or_are_exchanged(
    make_dataset: Any, recipe: Any, encoded: bool
) -> None:
    harms: tuple[Callable[[Path], object], ...] = (Path.unlink, truncate, exchange, shutil.rmtree)
    for number, harm in enumerate(harms):
        dataset = make_dataset(full(recipe, encoded=encoded), name=str(number))
        windows = open_windows(dataset, rgb=[])
        before = windows[40]
        folder = Path(dataset.episode_location(0))
        (file,) = (p for p in (folder / "streams/tactile/data/c").rglob("*") if p.is_file())
        harm(folder if harm is shutil.rmtree else file)
        # While the file is open, what was there is read, or nothing.
        if harm is truncate:
            with pytest.raises(DamagedDataError, match="cut short"):
                windows[40]
            continue
        assert torch.equal(windows[40]["tactile"], before["tactile"])
        windows._readers._files.clear()  # as many other open files would do
        with pytest.raises(ChangedDataError, match="changed after"):
            windows[40]


def truncate(file: Path) -> None:
    os.truncate(file, 1000)


def exchange(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[:1000] = bytes(1000)
    other = file.with_name("other")
    other.write_bytes(content)
    other.rename(file)


def test_a_packed_episode_that_is_exchanged(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    folder = Path(dataset.episode_location(0))
    pack(folder)
    shutil.rmtree(folder)
    root = Path(dataset.path)
    table, _ = build_catalog(root)
    write_catalog(root, table)
    windows = open_windows(open_dataset(root))
    before = windows[40]
    packed = Path(windows.episodes.episode_location(0))
    content = packed.read_bytes()
    other = packed.with_name("other")
    other.write_bytes(content)
    other.rename(packed)
    assert torch.equal(windows[40]["tactile"], before["tactile"])
    windows._readers._files.clear()
    with pytest.raises(ChangedDataError, match="changed after"):
        windows[40]


def test_unknown_policies_are_refused(make_dataset: Any, recipe: Any) -> None:
    with pytest.raises(UsageError, match="'skip'"):
        open_windows(make_dataset(full(recipe)), on_corrupt="ignore")
