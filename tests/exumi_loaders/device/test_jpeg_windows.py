"""Windows whose frames stay JPEG files: masks, damage and several datasets as without."""

import shutil
from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import exumi_data
from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_data.store.shards import ArrayWriter, crc32c
from exumi_loaders import ConcatWindows, DecodeJpeg, TPPWindows
from exumi_loaders.device import JpegFrames

FRAME = 60  # the damaged one: at 2 s, tick 40
SECONDS = np.arange(180) / 30


def full(recipe: Any, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "tactile_s": SECONDS,
        "rgb_s": SECONDS,
        "pose_s": SECONDS,
        "activity": np.repeat([0.0, 0.01, 0.0], 60),
        "encoded": True,
        "channels": 3,
        "side": 16,
    }
    return recipe(**{**values, **changes})


def open_windows(dataset: exumi_data.Dataset, **options: Any) -> TPPWindows:
    fixed: dict[str, Any] = {"tick_s": Fraction(1, 20), "cache": False, "grey_tactile": True}
    return TPPWindows(dataset, **{**fixed, **options})


def check_same(files: Any, images: Any) -> None:
    """What the files become is what the windows decode, and everything else is the same."""
    assert any(isinstance(value, JpegFrames) for value in files.values())
    done = DecodeJpeg()(files)
    assert list(done) == list(images)
    for name, value in images.items():
        assert torch.equal(done[name], value), name


# ------------------------------------------------------------------------------- what is left out


@pytest.mark.parametrize(
    "options",
    [
        {"mask": "tactile_history"},
        {"mask": "action+rgb"},
        {"dropout": {"tactile_history": 0.5, "rgb": 0.5}, "proprioception": True, "seed": 4},
        {"history_frames": 2, "future_frames": 3, "rgb_steps": (-15, 0, 16)},
    ],
)
def test_the_same_windows_whatever_is_left_out(
    make_dataset: Any, recipe: Any, options: dict[str, Any]
) -> None:
    dataset = make_dataset(full(recipe))
    images, files = (open_windows(dataset, decode=way, **options) for way in ("cpu", "device"))
    indices = list(range(0, 120, 3))
    batch = files.__getitems__(indices)
    check_same(batch, images.__getitems__(indices))
    for name in ("tactile", "rgb"):
        frames = batch[name]
        there = frames.span[..., 0] < frames.span[..., 1]
        assert torch.equal(there, batch[f"{name}_valid"])  # what is hidden has no file
        assert len(frames.data) == sum(map(len, frames.files()[0]))  # nothing else is carried
    if "mask" in options:
        assert not (batch["rgb_valid"].all() and batch["tactile_valid"].all())


def test_what_is_hidden_is_not_read(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    Path(dataset.episode_location(0), "streams/rgb/data/c/0").unlink()
    item = open_windows(dataset, decode="device", mask="rgb")[40]
    assert not item["rgb_valid"].any()
    assert not len(item["rgb"].data)
    assert item["valid"]


def test_the_spec_says_so(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    images, files = (open_windows(dataset, decode=way) for way in ("cpu", "device"))
    assert str(images.spec["tactile"]) == "(8, 1, 16, 16) uint8"
    assert str(files.spec["tactile"]) == "(8, 1, 16, 16) uint8 as JPEG files"
    assert not files.spec["tactile_reference"].files
    item = files[40]
    assert set(item) == set(files.spec)
    for name, spec in files.spec.items():
        assert isinstance(item[name], JpegFrames) == spec.files
        if spec.files:
            assert item[name].size == spec.shape[-3:]
            assert item[name].span.shape == (spec.shape[0], 2)


# ----------------------------------------------------------------------------------------- damage


def a_wrong_checksum(content: np.ndarray) -> None:
    content[20:28] = 255


def another_size(content: np.ndarray) -> None:
    start = bytes(content).index(b"\xff\xc0") + 5
    content[start : start + 4] = np.frombuffer((17).to_bytes(2, "big") * 2, np.uint8)


def too_many_scans(content: np.ndarray) -> None:
    content[-140:] = np.tile(np.array([255, 0xDA], np.uint8), 70)


def no_jpeg(content: np.ndarray) -> None:
    content[:] = 0


Harm = Callable[[np.ndarray], None]
HARMS: dict[Harm, str] = {
    a_wrong_checksum: "wrong checksum",
    another_size: "the JPEG is 17x17, the metadata says 16x16",
    too_many_scans: "scans",
    no_jpeg: "not a JPEG",
}


def damage(dataset: exumi_data.Dataset, harm: Harm) -> None:
    """Spoil one frame's file in place; its checksum is made right again, but for one harm."""
    folder = Path(dataset.episode_location(0), "streams/tactile")
    with dataset[0] as episode:
        offset = np.asarray(episode["tactile"]._frame_source.offset).astype(int)  # type: ignore[attr-defined]
    shard = folder / "data/c/0"
    content = np.frombuffer(bytearray(shard.read_bytes()), np.uint8)
    harm(content[offset[FRAME] : offset[FRAME + 1]])
    shard.write_bytes(content.tobytes())
    if harm is a_wrong_checksum:
        return
    sums = [crc32c(content[start:stop].tobytes()) for start, stop in pairwise(offset)]
    shutil.rmtree(folder / "crc32c")
    writer = ArrayWriter(folder / "crc32c", np.dtype(np.uint32), (), chunk_rows=8192, zstd=True)
    writer.append(np.array(sums, np.uint32))
    writer.finish()


@pytest.mark.parametrize("harm", HARMS)
def test_damage_is_found_before_the_file_leaves(make_dataset: Any, recipe: Any, harm: Harm) -> None:
    dataset = make_dataset(full(recipe))
    damage(dataset, harm)
    windows = open_windows(dataset, decode="device", random_history=False)
    with pytest.raises(DamagedDataError, match=HARMS[harm]) as caught:
        windows[40]
    assert caught.value.where is not None
    assert caught.value.where.endswith(f"stream tactile, frame {FRAME}")
    assert dataset.ids[0] in caught.value.where
    assert not isinstance(caught.value, ChangedDataError)


@pytest.mark.parametrize("policy", ["skip", "substitute"])
@pytest.mark.parametrize("harm", HARMS)
def test_damaged_files_are_skipped_or_substituted_as_frames_are(
    make_dataset: Any, recipe: Any, harm: Harm, policy: str
) -> None:
    dataset = make_dataset(full(recipe))
    damage(dataset, harm)
    images, files = (
        open_windows(dataset, decode=way, on_corrupt=policy, random_history=False)
        for way in ("cpu", "device")
    )
    indices = list(range(20, 70))
    batch = files.__getitems__(indices)
    check_same(batch, images.__getitems__(indices))
    counted = batch["replaced" if policy == "skip" else "substituted"]
    assert 0 < (counted > 0).sum() < len(indices)
    if policy == "substitute":
        assert torch.equal((~batch["tactile_valid"]).sum(dim=1), counted)


def test_a_stream_that_cannot_be_opened(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    Path(dataset.episode_location(0), "streams/tactile/data/c/0").unlink()
    item = open_windows(dataset, decode="device", on_corrupt="substitute")[50]
    assert item["substituted"] == 8
    assert not len(item["tactile"].data)
    assert item["rgb_valid"].all()
    with pytest.raises(DamagedDataError, match="drawn to replace it"):
        open_windows(dataset, decode="device", on_corrupt="skip")[0]


# ------------------------------------------------------------------------------- several datasets


def test_several_datasets(make_dataset: Any, recipe: Any) -> None:
    sets = [make_dataset(full(recipe, shift=10 * n), name=str(n)) for n in range(2)]
    images, files = (
        ConcatWindows([open_windows(one, decode=way) for one in sets]) for way in ("cpu", "device")
    )
    indices = [3, 130, 40, 200, 40]
    check_same(files.__getitems__(indices), images.__getitems__(indices))
    loader = files.loader(16, shuffle=False, num_workers=1)
    check_same(next(iter(loader)), images.__getitems__(range(16)))


def test_files_and_images_are_not_mixed(make_dataset: Any, recipe: Any) -> None:
    encoded = make_dataset(full(recipe), name="encoded")
    plain = make_dataset(full(recipe, encoded=False), name="plain")
    for dataset, way in ((plain, "device"), (encoded, "cpu")):
        parts = [open_windows(encoded, decode="device"), open_windows(dataset, decode=way)]
        with pytest.raises(UsageError, match="as JPEG files in part 0") as caught:
            ConcatWindows(parts)
        assert caught.value.fix is not None
        assert 'decode="cpu"' in caught.value.fix
