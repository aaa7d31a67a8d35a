"""Octopi-1.5's input, against its steps in numpy."""

import cv2
import numpy as np
import pytest
import torch

from exumi_data.errors import UsageError
from exumi_data.standard import sensors
from exumi_loaders import NormaliseSensor, OctopiImages, ToFloat
from exumi_loaders.device import OCTOPI_SENSORS, octopi_sensor


def test_each_window_has_its_own_sensor() -> None:
    images = torch.rand(3, 2, 3, 5, 4)
    names = ["digit", "gelsightmini", "digit"]
    done = NormaliseSensor()(images, names)
    for window, result, name in zip(images, done, names, strict=True):
        mean, deviation = (np.array(row).reshape(3, 1, 1) for row in OCTOPI_SENSORS[name])
        np.testing.assert_allclose(result, (window.numpy() - mean) / deviation, atol=1e-5)
    assert torch.equal(NormaliseSensor()(images[:1], "digit"), done[:1])


def test_the_mean_becomes_zero_and_so_does_the_margin() -> None:
    mean = torch.tensor(OCTOPI_SENSORS["gelsightmini"][0]).view(1, 1, 3, 1, 1)
    images = mean.expand(2, 3, 3, 240, 320).clone()
    done = OctopiImages("gelsightmini")({"x": images, "x_reference": images[:, 0]})
    assert done["x"].shape == (2, 3, 3, 224, 224)
    assert done["x_reference"].shape == (2, 3, 224, 224)
    assert torch.allclose(done["x"], torch.zeros(()), atol=1e-5)


def test_padded_above_and_below_and_resized() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (56, 84, 3), dtype=np.uint8)
    image = cv2.GaussianBlur(noise, (0, 0), 3)  # bicubic kernels agree where images are smooth
    frames = torch.from_numpy(image).movedim(-1, 0)[None, None]
    done = OctopiImages("digit", size=168)(ToFloat()({"x": frames}))["x"][0, 0]
    mean, deviation = (np.array(row) for row in OCTOPI_SENSORS["digit"])
    square = np.pad((image / 255 - mean) / deviation, ((14, 14), (0, 0), (0, 0)))
    expected = cv2.resize(square, (168, 168), interpolation=cv2.INTER_CUBIC)
    inside = slice(34, 134)  # away from the margin's edge
    found = done.movedim(0, -1).numpy()
    np.testing.assert_allclose(found[inside], expected[inside], atol=0.05)


def test_registered_sensors_have_their_names() -> None:
    assert octopi_sensor("gelsight-mini", "dotted") == "gelsightminidotted"
    assert octopi_sensor("digit") == "digit"
    assert {"gelsight-mini", "gelsight-1-7", "digit"} <= set(sensors())
    with pytest.raises(UsageError, match="gelsight-mini"):
        octopi_sensor("9dtact")


def test_nonsense_is_refused() -> None:
    module = NormaliseSensor()
    with pytest.raises(UsageError, match="1 channel"):
        module(torch.rand(1, 1, 1, 4, 4), "digit")
    with pytest.raises(UsageError, match="2 sensors for 1"):
        module(torch.rand(1, 1, 3, 4, 4), ["digit", "digit"])
    with pytest.raises(UsageError, match="'mini'"):
        module(torch.rand(1, 1, 3, 4, 4), "mini")
    with pytest.raises(UsageError, match="ToFloat"):
        module(torch.zeros(1, 1, 3, 4, 4, dtype=torch.uint8), "digit")
