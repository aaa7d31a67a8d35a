"""Sizes, places and margins."""

import cv2
import numpy as np
import pytest
import torch

from exumi_data.errors import UsageError
from exumi_loaders import CentreCrop, PadToSquare, RandomCrop, Resize


def coordinates(windows: int, height: int, width: int) -> torch.Tensor:
    """Images whose pixels tell their row and column, (B, 1, 3, H, W) float."""
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    image = torch.stack((row, column, torch.zeros_like(row))).float()
    return image.expand(windows, 1, -1, -1, -1).clone()


def test_resizing_by_area_is_opencvs() -> None:
    image = np.random.default_rng(0).integers(0, 256, (48, 60), dtype=np.uint8)
    frames = torch.from_numpy(image)[None, None, None]
    expected = cv2.resize(image, (15, 12), interpolation=cv2.INTER_AREA).astype(int)
    done = Resize((12, 15), mode="area")({"x": frames})["x"]
    assert done.dtype == torch.uint8
    assert np.abs(done[0, 0, 0].numpy().astype(int) - expected).max() <= 1


@pytest.mark.parametrize("mode", ["area", "bilinear", "bicubic"])
def test_resizing_keeps_an_even_image(mode: str) -> None:
    frames = torch.full((2, 3, 3, 40, 30), 77, dtype=torch.uint8)
    batch = {"x": frames, "x_reference": frames[:, 0]}
    done = Resize(17, mode=mode)(batch)  # type: ignore[arg-type]  # one of the three words
    assert done["x"].shape == (2, 3, 3, 17, 17)
    assert done["x_reference"].shape == (2, 3, 17, 17)
    assert (done["x"] == 77).all()
    floats = Resize((50, 60), mode=mode)({"x": frames / 255})["x"]  # type: ignore[arg-type]
    assert torch.allclose(floats, torch.tensor(77 / 255))


def test_the_centre() -> None:
    done = CentreCrop((4, 6))({"x": coordinates(2, 10, 20)})["x"]
    assert done.shape == (2, 1, 3, 4, 6)
    assert done[0, 0, 0, :, 0].tolist() == [3, 4, 5, 6]
    assert done[1, 0, 1, 0].tolist() == [7, 8, 9, 10, 11, 12]


def test_random_crops_are_rectangles_from_anywhere() -> None:
    images = coordinates(400, 10, 12)
    done = RandomCrop((7, 8), seed=1)({"x": images})["x"]
    assert done.shape == (400, 1, 3, 7, 8)
    places = set()
    for window in done[:, 0]:
        top, left = int(window[0, 0, 0]), int(window[1, 0, 0])
        assert torch.equal(window, images[0, 0, :, top : top + 7, left : left + 8])
        places.add((top, left))
    assert places == {(top, left) for top in range(4) for left in range(5)}


@pytest.mark.parametrize("module", [CentreCrop(9), RandomCrop(9)])
def test_a_crop_that_is_too_large(module: torch.nn.Module) -> None:
    with pytest.raises(UsageError, match="crop"):
        module({"x": torch.zeros(1, 1, 1, 8, 20)})


def test_a_square_around_the_middle() -> None:
    images = torch.ones(2, 1, 3, 4, 7)
    done = PadToSquare(0.5)({"x": images, "x_reference": images[:, 0]})
    assert done["x"].shape == (2, 1, 3, 7, 7)
    assert done["x_reference"].shape == (2, 3, 7, 7)
    assert done["x"][0, 0, 0, :, 0].tolist() == [0.5, 1, 1, 1, 1, 0.5, 0.5]


def test_nonsense_is_refused() -> None:
    with pytest.raises(UsageError, match="size"):
        Resize(0)
    with pytest.raises(UsageError, match="mode"):
        Resize(8, mode="lanczos")  # type: ignore[arg-type]  # wrong on purpose
