"""A Gaussian, against OpenCV."""

import cv2
import numpy as np
import pytest
import torch

from exumi_data.errors import UsageError
from exumi_loaders import Blur


@pytest.mark.parametrize("channels", [1, 3])
def test_is_opencvs(channels: int) -> None:
    image = np.random.default_rng(0).random((40, 32, channels), dtype=np.float32)
    frames = torch.from_numpy(image).movedim(-1, 0)[None, None]
    done = Blur((1.5, 1.5), p=1.0)({"x": frames, "x_reference": frames[:, 0]})
    expected = cv2.GaussianBlur(image, (11, 11), 1.5, borderType=cv2.BORDER_REFLECT_101)
    expected = expected.reshape(image.shape)
    np.testing.assert_allclose(done["x"][0, 0].movedim(0, -1).numpy(), expected, atol=1e-5)
    np.testing.assert_allclose(done["x_reference"][0].numpy(), done["x"][0, 0].numpy())


def test_as_many_windows_as_the_probability_says() -> None:
    frames = torch.rand(300, 1, 1, 16, 16)
    done = Blur((1.0, 2.0), p=0.3, seed=1)({"x": frames})["x"]
    same = (done == frames).flatten(1).all(dim=1)
    assert 0.6 < same.float().mean() < 0.8
    blurred = done[~same]
    assert (blurred.flatten(1).std(dim=1) < 0.8 * frames[~same].flatten(1).std(dim=1)).all()


def test_nonsense_is_refused() -> None:
    for options in ({"sigma_px": (0.0, 1.0)}, {"sigma_px": (2.0, 1.0)}, {"p": 1.5}):
        with pytest.raises(UsageError):
            Blur(**options)
    with pytest.raises(UsageError, match="reaches"):
        Blur((1.0, 3.0), p=1.0)({"x": torch.zeros(1, 1, 1, 8, 8)})
    with pytest.raises(UsageError, match="ToFloat"):
        Blur()({"x": torch.zeros(1, 1, 1, 32, 32, dtype=torch.uint8)})
