"""Vision models as encoders."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import exumi_data
from exumi_data.errors import DamagedDataError, UsageError
from exumi_loaders.encoder import Encoder, Kind
from exumi_loaders.retrieval.index import TactileIndex
from exumi_loaders.texture import TextureEncoder
from exumi_loaders.vision import OCTOPI_STATISTICS, Statistics, VisionEncoder
from tests.exumi_loaders.retrieval.gratings import write_gratings

PLAIN: dict[Kind, Statistics] = {(None, None): ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))}


class Tower(torch.nn.Module):
    """Colours of the four quarters."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(12))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        quarters = torch.nn.functional.adaptive_avg_pool2d(images, 2)
        return quarters.flatten(1) * self.scale


class Wrapped(torch.nn.Module):
    def forward(self, images: torch.Tensor) -> dict[str, torch.Tensor]:
        return {"embeds": images.mean((2, 3))}


def test_an_embedding_is_the_mean_over_frames_of_length_one() -> None:
    encoder = VisionEncoder(Tower(), statistics=PLAIN, size=16, batch=2)
    assert isinstance(encoder, Encoder)
    frames = np.random.default_rng(0).integers(0, 255, (5, 16, 16, 3)).astype(np.uint8)
    vector = encoder.encode(frames)
    quarters = (frames / 255).reshape(5, 2, 8, 2, 8, 3).mean((2, 4)).mean(0)
    expected = quarters.transpose(2, 0, 1).ravel()
    np.testing.assert_allclose(vector, expected / np.linalg.norm(expected), atol=1e-5)
    assert vector.shape == (encoder.dimension,) == (12,)
    assert vector.dtype == np.float32


def test_frames_are_normalised_then_padded_to_a_square() -> None:
    statistics: Any = {(None, None): ((0.5, 0.5, 0.5), (0.25, 0.5, 1.0))}
    encoder = VisionEncoder(Tower(), statistics=statistics, size=16)
    white = np.full((1, 8, 16, 1), 255, np.uint8)
    images = encoder.prepare(white)
    assert images.shape == (1, 3, 16, 16)
    np.testing.assert_allclose(images[0, :, 8, 8], (2, 1, 0.5), atol=1e-6)
    np.testing.assert_allclose(images[0, :, :2], 0, atol=1e-6)  # the padding is not normalised
    np.testing.assert_allclose(images[0, :, -2:], 0, atol=1e-6)
    assert encoder.prepare(white.transpose(0, 2, 1, 3)).shape == (1, 3, 16, 16)


def test_statistics_are_those_of_the_sensor() -> None:
    encoder = VisionEncoder(Tower(), size=16)
    grey = np.full((1, 16, 16, 3), 128, np.uint8)
    kinds = [
        ("gelsight-mini", "plain"),
        ("gelsight-mini", "dotted"),
        ("digit", "plain"),
        ("x", "y"),
    ]
    made = [encoder.prepare(grey, kind=kind)[0, 0, 8, 8].item() for kind in kinds]
    assert len(set(made)) == 4
    mean, spread = OCTOPI_STATISTICS["gelsight-mini", "plain"]
    assert made[0] == pytest.approx((128 / 255 - mean[0]) / spread[0], abs=1e-5)
    strict = VisionEncoder(Tower(), statistics=OCTOPI_STATISTICS, size=16)
    with pytest.raises(UsageError, match="no statistics for sensor 'x'"):
        strict.prepare(grey, kind=("x", None))


def test_weights_are_read_and_told_by_their_digest(tmp_path: Path) -> None:
    trained = Tower()
    trained.scale.data[:] = torch.arange(12.0)
    torch.save(trained.state_dict(), tmp_path / "weights.pt")
    frames = np.full((1, 16, 16, 3), 200, np.uint8)
    read = VisionEncoder(Tower(), weights=tmp_path / "weights.pt", size=16)
    handed = VisionEncoder(trained, size=16)
    fresh = VisionEncoder(Tower(), size=16)
    np.testing.assert_array_equal(read.encode(frames), handed.encode(frames))
    assert read.digest == handed.digest
    assert len({read.digest, fresh.digest, VisionEncoder(trained, size=8).digest}) == 3


# PyTorch would rather have other formats; such files are there.
@pytest.mark.filterwarnings("ignore:.*torch.jit.*deprecated:DeprecationWarning")
def test_a_torchscript_file_is_an_encoder(tmp_path: Path) -> None:
    traced: Any = torch.jit.trace(Tower(), torch.zeros(1, 3, 16, 16))  # type: ignore[no-untyped-call]  # PyTorch does not say
    traced.save(str(tmp_path / "tower.pt"))
    frames = np.full((2, 16, 16, 3), 200, np.uint8)
    script = VisionEncoder(tmp_path / "tower.pt", size=16)
    np.testing.assert_allclose(
        script.encode(frames), VisionEncoder(Tower(), size=16).encode(frames), atol=1e-6
    )
    with pytest.raises(UsageError, match="has its own"):
        VisionEncoder(tmp_path / "tower.pt", weights=tmp_path / "tower.pt")
    (tmp_path / "none.pt").write_bytes(b"no program")
    with pytest.raises(DamagedDataError, match="no TorchScript"):
        VisionEncoder(tmp_path / "none.pt")


class _Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (Path("went-off"),))


def test_weights_never_run_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"scale": _Bomb()}, tmp_path / "bomb.pt")
    with pytest.raises(UsageError, match="weights do not fit"):
        VisionEncoder(Tower(), weights=tmp_path / "bomb.pt", size=16)
    assert not (tmp_path / "went-off").exists()
    torch.save({"other": torch.ones(3)}, tmp_path / "other.pt")
    with pytest.raises(UsageError, match="weights do not fit"):
        VisionEncoder(Tower(), weights=tmp_path / "other.pt", size=16)


def test_what_the_model_gives_is_checked() -> None:
    assert VisionEncoder(Wrapped(), output="embeds", size=16).dimension == 3
    with pytest.raises(UsageError, match="output="):
        VisionEncoder(Wrapped(), size=16)
    encoder = VisionEncoder(Tower(), size=16)
    for frames in (np.zeros((0, 8, 8, 3), np.uint8), np.zeros((1, 8, 8, 4), np.uint8)):
        with pytest.raises(UsageError, match="expected"):
            encoder.encode(frames)


def test_an_index_of_a_vision_model_needs_it(tmp_path: Path) -> None:
    dataset = exumi_data.open(write_gratings(tmp_path / "gratings"))
    assert isinstance(dataset, exumi_data.Dataset)
    encoder = VisionEncoder(Tower(), size=16)
    index = TactileIndex.build(dataset, encoder, path=tmp_path / "index")
    assert (index.info().space, index.info().dimension) == (None, 12)
    alone = TactileIndex.open(tmp_path / "index")
    frames = np.full((2, 32, 32, 1), 9, np.uint8)
    with pytest.raises(UsageError, match="not at hand"):
        alone.query(frames)
    assert alone.query(index.embed(frames)) == index.query(frames)
    with pytest.raises(UsageError, match="cannot be compared"):
        TactileIndex.open(tmp_path / "index", encoder=TextureEncoder(1))
