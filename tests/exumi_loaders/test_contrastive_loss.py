"""InfoNCE against its formula."""

import math

import numpy as np
import pytest
import torch

from exumi_data.errors import UsageError
from exumi_loaders import InfoNCE, info_nce


def formula(embeddings: np.ndarray, temperature: float) -> float:
    """The text's formula, one sum after the other."""
    unit = embeddings / np.linalg.norm(embeddings, axis=-1, keepdims=True)
    total = 0.0
    for one, other in ((unit[:, 0], unit[:, 1]), (unit[:, 1], unit[:, 0])):
        for i, anchor in enumerate(one):
            similar = [math.exp(float(anchor @ candidate) / temperature) for candidate in other]
            total -= math.log(similar[i] / sum(similar))
    return total / (2 * len(unit))


@pytest.mark.parametrize("temperature", [0.07, 1.0])
def test_the_loss_is_the_formula(temperature: float) -> None:
    embeddings = np.random.default_rng(0).normal(size=(7, 2, 5))
    loss = info_nce(torch.from_numpy(embeddings), torch.arange(7), temperature)
    assert float(loss) == pytest.approx(formula(embeddings, temperature), rel=1e-5)


def test_the_order_of_the_two_clips_does_not_matter() -> None:
    embeddings = torch.randn(6, 2, 4, generator=torch.Generator().manual_seed(0))
    parts = torch.arange(6)
    swapped = info_nce(embeddings.flip(1), parts, 0.1)
    torch.testing.assert_close(swapped, info_nce(embeddings, parts, 0.1))


def test_the_temperature_begins_at_007_and_is_learnt() -> None:
    loss = InfoNCE()
    assert float(loss.temperature.detach()) == pytest.approx(0.07)
    embeddings = torch.eye(4).unsqueeze(1).repeat(1, 2, 1)  # perfect: colder is better
    optimiser = torch.optim.SGD(loss.parameters(), lr=1000.0)
    for _ in range(20):
        optimiser.zero_grad()
        loss(embeddings, torch.arange(4)).backward()
        optimiser.step()
    assert 0.01 <= float(loss.temperature.detach()) < 0.069


@pytest.mark.parametrize(
    ("shape", "parts", "said"),
    [((3, 2, 4), [0, 1, 0], "twice"), ((3, 4), [0, 1, 2], "P, 2, D"), ((2, 2, 4), [0], "P, 2, D")],
)
def test_wrong_batches_are_refused(shape: tuple[int, ...], parts: list[int], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        info_nce(torch.ones(shape), torch.tensor(parts), 0.07)
