"""JPEG files leave the windows as they are, and become the same frames."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from exumi_data.dataset import open_dataset
from exumi_data.errors import DamagedDataError, MissingExtraError, UsageError
from exumi_data.store import jpeg
from exumi_loaders import DecodeJpeg, TPPWindows
from exumi_loaders.device import JpegFrames
from exumi_loaders.device.jpeg_frames import pack_files

SECONDS = np.arange(0, 4, 1 / 30)


@pytest.fixture
def dataset(make_dataset: Any, recipe: Any) -> Any:
    gap = np.delete(SECONDS, slice(40, 60))
    return make_dataset(
        recipe(tactile_s=SECONDS, rgb_s=SECONDS, encoded=True, channels=3, side=16),
        recipe(tactile_s=gap, rgb_s=SECONDS, encoded=True, channels=3, side=16),
    )


@pytest.mark.parametrize("grey", [False, True])
def test_the_same_batches_as_the_windows_make(dataset: Any, grey: bool) -> None:
    options: dict[str, Any] = {"cache": False, "grey_tactile": grey, "seed": 3}
    here = TPPWindows(dataset, **options)
    there = TPPWindows(dataset, decode="device", **options)
    decode = DecodeJpeg()
    missing = 0
    for start in range(0, len(here) - 16, 16):
        indices = list(range(start, start + 16))
        expected, files = here.__getitems__(indices), there.__getitems__(indices)
        assert isinstance(files["tactile"], JpegFrames)
        done = decode(files)
        assert done.keys() == expected.keys()
        for name, value in expected.items():
            assert torch.equal(done[name], value), name
        assert done["tactile"].stride() == expected["tactile"].stride()
        missing += int((~expected["tactile_valid"]).sum())
    assert missing > 0


def test_one_window_and_a_loader_with_workers(dataset: Any) -> None:
    windows = TPPWindows(dataset, cache=False, decode="device")
    plain = TPPWindows(dataset, cache=False)
    item = DecodeJpeg()(windows[20])
    assert torch.equal(item["tactile"], plain[20]["tactile"])
    loader = windows.loader(8, shuffle=False, num_workers=1)
    batch = DecodeJpeg()(next(iter(loader)))
    assert torch.equal(batch["rgb"], plain.__getitems__(list(range(8)))["rgb"])


def test_a_file_is_there_once(dataset: Any) -> None:
    windows = TPPWindows(dataset, cache=False, decode="device")
    frames = windows.__getitems__([30, 30, 31])["tactile"]
    files, number = frames.files()
    assert len(frames) == 3
    assert number.shape == (3, 8)
    assert sum(map(len, files)) == len(frames.data)
    assert len(files) == len({tuple(span) for span in frames.span.reshape(-1, 2).tolist()})
    assert len(files) < number.size


def test_frames_that_are_not_jpeg_are_images_all_the_same(make_dataset: Any, recipe: Any) -> None:
    windows = TPPWindows(make_dataset(recipe(tactile_s=SECONDS)), cache=False, decode="device")
    batch = windows[20]
    assert isinstance(batch["tactile"], torch.Tensor)
    assert DecodeJpeg()(batch)["tactile"] is batch["tactile"]


def test_nothing_there_at_all() -> None:
    done = DecodeJpeg().decode(pack_files(np.full((2, 3), None, dtype=object), (4, 5, 1)))
    assert done.shape == (2, 3, 1, 4, 5)
    assert (done == 0).all()


def test_a_damaged_file_is_named(dataset: Any) -> None:
    frames = TPPWindows(dataset, cache=False, decode="device").__getitems__([30])["rgb"]
    start, stop = frames.span[0, 0].tolist()
    data = frames.data.clone()
    data[start:stop] = 0
    with pytest.raises(DamagedDataError, match="rgb"):
        DecodeJpeg()({"rgb": JpegFrames(data, frames.span, frames.size)})


def test_damage_on_disk_is_found_before_the_file_leaves(dataset: Any) -> None:
    shard = next(
        path
        for path in sorted((Path(dataset.path) / "episodes").rglob("tactile/data/c/0"))
        if dataset.ids[0] in str(path)
    )
    content = bytearray(shard.read_bytes())
    content[:2000] = bytes(2000)
    shard.write_bytes(content)
    damaged = open_dataset(dataset.path).select(dataset.ids[:1])
    windows = TPPWindows(damaged, cache=False, decode="device", random_history=False)
    with pytest.raises(DamagedDataError, match=r"tactile"):
        windows[0]


def test_a_file_that_claims_another_size_is_refused() -> None:
    data = jpeg.encode(np.zeros((8, 8, 1), np.uint8), 90)
    jpeg.check(data, (8, 8))
    with pytest.raises(DamagedDataError, match="8x8, the metadata says 9x8"):
        jpeg.check(data, (8, 9))
    scans = data[:-2] + b"\xff\xda" * 100 + data[-2:]
    with pytest.raises(DamagedDataError, match="scans"):
        jpeg.check(scans, (8, 8))


def test_other_devices_are_refused() -> None:
    with pytest.raises(UsageError, match="meta"):
        DecodeJpeg("meta")
    with pytest.raises(UsageError, match="decode"):
        TPPWindows(None, decode="gpu")  # type: ignore[arg-type]  # refused before the dataset


def test_without_torchvision_one_line_says_what_to_install() -> None:
    try:
        import torchvision  # noqa: F401  # whether it is there
    except ModuleNotFoundError:
        with pytest.raises(MissingExtraError, match=r"exumi-data\[gpu\]"):
            DecodeJpeg("cuda")
    else:
        pytest.skip("torchvision is installed")


def smooth(channels: int, side: int = 224) -> np.ndarray:
    """A smooth image with some grain, like that of a gel."""
    import cv2

    noise = np.random.default_rng(0).normal(size=(side, side, channels))
    image = 120 + 500 * cv2.GaussianBlur(noise, (0, 0), 8).reshape(noise.shape) + 3 * noise
    return np.asarray(np.clip(image, 0, 255), np.uint8)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@pytest.mark.parametrize("channels", [1, 3])
def test_cuda_gives_the_same_pixels_within_the_tolerance(channels: int) -> None:
    pytest.importorskip("torchvision")
    data = jpeg.encode(smooth(channels), 95)
    span = torch.tensor([[[0, len(data)], [0, 0]], [[0, len(data)]] * 2])
    bytes_ = torch.frombuffer(bytearray(data), dtype=torch.uint8)
    frames = JpegFrames(bytes_, span, (224, 224, channels))
    here, there = DecodeJpeg().decode(frames), DecodeJpeg("cuda").decode(frames)
    assert there.is_cuda
    assert there.shape == here.shape
    difference = (there.cpu().int() - here.int()).abs().float()
    assert difference.mean() < 1
    assert difference.max() <= (2 if channels == 1 else 32)
