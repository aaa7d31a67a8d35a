"""The encoder that needs no weights."""

import numpy as np
import pytest

from exumi_data.errors import UsageError
from exumi_loaders.texture import TextureEncoder, _magnitudes, _step

REST = np.full((64, 96, 3), 120, dtype=np.uint8)


def pressed(period: int, count: int = 4, seed: int = 0) -> np.ndarray:
    """Frames in which a grating is pressed into the gel, somewhere else each time."""
    shifts = np.random.default_rng(seed).integers(0, period, count)
    x = np.arange(96)
    rows = [120 + 40 * np.sin(2 * np.pi * (x + shift) / period) for shift in shifts]
    frames = np.stack([np.broadcast_to(row[:, None], (64, 96, 3)) for row in rows])
    return np.round(frames).astype(np.uint8)


def test_a_clip_is_nearer_to_another_of_its_texture_than_to_others() -> None:
    encoder = TextureEncoder()
    fine, again, coarse = (
        encoder.encode(frames, REST)
        for frames in (pressed(6), pressed(6, seed=1), pressed(24, seed=2))
    )
    assert np.linalg.norm(fine - again) < 0.1 * np.linalg.norm(fine - coarse)


def test_what_is_not_pressed_says_nothing() -> None:
    vector = TextureEncoder().encode(np.stack([REST, REST]), REST)
    assert vector.dtype == np.float32
    np.testing.assert_allclose(vector, 0, atol=1e-5)


def test_grey_and_colour_are_told_apart() -> None:
    grey = TextureEncoder(1)
    assert grey.encode(pressed(6)[..., :1], REST[..., :1]).shape == (grey.dimension,) == (114,)
    assert (
        TextureEncoder().encode(pressed(6), REST).shape == (TextureEncoder().dimension,) == (234,)
    )
    assert grey.digest != TextureEncoder().digest
    with pytest.raises(UsageError, match="made for 1"):
        grey.encode(pressed(6), REST)


@pytest.mark.parametrize(
    ("frames", "reference", "said"),
    [
        (pressed(6), None, "reference"),
        (pressed(6)[:0], REST, "at least one frame"),
        (pressed(6), REST[:32], "a reference of"),
    ],
)
def test_what_is_missing_is_said(
    frames: np.ndarray, reference: np.ndarray | None, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        TextureEncoder().encode(frames, reference)


def test_other_channels_than_1_and_3_are_refused() -> None:
    with pytest.raises(UsageError, match="channels"):
        TextureEncoder(4)


def test_magnitudes_are_those_of_all_pixels_or_nearly() -> None:
    """Percentiles are told from a sample, spread over rows and columns."""
    random = np.random.default_rng(0)
    stripes = np.abs(np.arange(320) % 8 - 3.5) * 10  # a sample of every 8th column would be blind
    band = (stripes[None, :, None] + random.normal(0, 3, (240, 320, 3))).astype(np.float32)
    found = np.expm1(_magnitudes(band)).reshape(3, 3)
    size = np.abs(band).reshape(-1, 3)
    expected = (size.mean(0), *np.percentile(size, (90, 99), axis=0))
    np.testing.assert_allclose(found, expected, rtol=0.03)
    assert _step(240 * 320, 320) > 1
