"""The representation against numpy, in integers that cannot wrap."""

import numpy as np
import torch

from exumi_loaders import TactileRepresentation


def test_equals_the_definition() -> None:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2, 8, 1, 12, 10), dtype=np.uint8)
    reference = rng.integers(0, 256, (2, 1, 12, 10), dtype=np.uint8)
    out = TactileRepresentation()(torch.from_numpy(frames), torch.from_numpy(reference)).numpy()
    assert out.shape == (2, 8, 3, 12, 10)
    assert out.dtype == np.float32
    grey = frames[:, :, 0].astype(np.int64)
    difference = 7 * (grey - reference[:, None, 0].astype(np.int64))
    np.testing.assert_allclose(out[:, :, 0], grey / 255, atol=1e-6)
    np.testing.assert_allclose(out[:, :, 1], np.clip(difference, 0, 255) / 255, atol=1e-5)
    np.testing.assert_allclose(out[:, :, 2], np.clip(-difference, 0, 255) / 255, atol=1e-5)


def test_differences_of_36_and_37_levels_do_not_wrap() -> None:
    reference = torch.full((1, 1, 2, 2), 100, dtype=torch.uint8)
    for level, expected in ((136, 252 / 255), (137, 1.0), (200, 1.0)):
        frames = torch.full((1, 1, 1, 2, 2), level, dtype=torch.uint8)
        out = TactileRepresentation()(frames, reference)
        assert torch.allclose(out[:, :, 1], torch.tensor(expected))
        assert (out[:, :, 2] == 0).all()


def test_colour_is_turned_to_luma() -> None:
    frames = torch.zeros((1, 1, 3, 2, 2), dtype=torch.uint8)
    frames[:, :, 1] = 200
    reference = torch.zeros((1, 3, 2, 2), dtype=torch.uint8)
    out = TactileRepresentation()(frames, reference)
    assert torch.allclose(out[:, :, 0], torch.tensor(0.587 * 200 / 255))


def test_numpy_and_torch_agree() -> None:
    from exumi_data.tactile import representation

    rng = np.random.default_rng(1)
    frame, reference = rng.integers(0, 256, (2, 9, 7), dtype=np.uint8)
    ours = TactileRepresentation()(
        torch.from_numpy(frame)[None, None], torch.from_numpy(reference)[None]
    )
    np.testing.assert_allclose(ours[0].numpy(), representation(frame, reference), atol=1e-5)
