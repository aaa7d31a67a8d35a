"""The encoder that needs no weights."""

import numpy as np
import pytest

from exumi_data.errors import UsageError
from exumi_loaders.texture import TextureEncoder

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
    assert grey.encode(pressed(6)[..., :1], REST[..., :1]).shape == (114,)
    assert TextureEncoder().encode(pressed(6), REST).shape == (234,)
    assert grey.digest != TextureEncoder().digest
    with pytest.raises(UsageError, match="made for 1"):
        grey.encode(pressed(6), REST)


@pytest.mark.parametrize(
    ("frames", "reference", "said"),
    [(pressed(6), None, "reference"), (pressed(6)[:0], REST, "at least one frame")],
)
def test_what_is_missing_is_said(
    frames: np.ndarray, reference: np.ndarray | None, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        TextureEncoder().encode(frames, reference)


def test_other_channels_than_1_and_3_are_refused() -> None:
    with pytest.raises(UsageError, match="channels"):
        TextureEncoder(4)
