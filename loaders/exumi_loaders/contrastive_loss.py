"""InfoNCE with a learnt temperature, as CLIP and Octopi use it."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from exumi_data.errors import UsageError

__all__ = ["FIRST_TEMPERATURE", "InfoNCE", "info_nce"]

FIRST_TEMPERATURE = 0.07
_LEAST_TEMPERATURE = 0.01
"""As in CLIP: a lower one makes training unstable."""


def info_nce(embeddings: Tensor, parts: Tensor, temperature: Tensor | float) -> Tensor:
    """Compute the symmetric InfoNCE loss of a contrastive batch.

    Parameters
    ----------
    embeddings : (P, 2, D) float
        Of the two clips of each part; they are normalised here.
    parts : (P,) int
        ``batch["part"]``: which part each is. All differ, or a positive would count as a negative.
    temperature : Tensor or float

    Returns
    -------
    () float
        Mean over both directions of −log softmax of the positive's cosine / temperature.

    Raises
    ------
    UsageError
        A shape is wrong, or a part comes twice.
    """
    if embeddings.ndim != 3 or embeddings.shape[1] != 2 or len(parts) != len(embeddings):
        raise UsageError(
            f"embeddings {tuple(embeddings.shape)} of {len(parts)} parts; expected (P, 2, D)"
        )
    if len(torch.unique(parts)) != len(parts):
        raise UsageError("a part is twice in the batch: its clips would count as negatives")
    first, second = functional.normalize(embeddings.float(), dim=-1).unbind(1)
    logits = first @ second.T / temperature
    positive = torch.arange(len(logits), device=logits.device)
    there = functional.cross_entropy(logits, positive)
    back = functional.cross_entropy(logits.T, positive)
    return (there + back) / 2


class InfoNCE(nn.Module):
    """InfoNCE whose temperature is learnt.

    Parameters
    ----------
    temperature : float
        To begin with.
    """

    def __init__(self, temperature: float = FIRST_TEMPERATURE) -> None:
        super().__init__()
        self.log_scale = nn.Parameter(torch.tensor(-math.log(temperature)))

    @property
    def temperature(self) -> Tensor:
        """The temperature of now, not below 0.01."""
        return torch.exp(-self.log_scale).clamp(min=_LEAST_TEMPERATURE)

    def forward(self, embeddings: Tensor, parts: Tensor) -> Tensor:
        """Compute the loss; see `info_nce`.

        Parameters
        ----------
        embeddings : (P, 2, D) float
        parts : (P,) int
        """
        return info_nce(embeddings, parts, self.temperature)
