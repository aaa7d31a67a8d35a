"""Random numbers of the modules, one draw for each window."""

import torch
from torch import Tensor, nn

__all__ = ["Draws"]


class Draws(nn.Module):
    """A source of random numbers that a checkpoint holds.

    Draws are made on the CPU, so that they are the same whatever the device. The generator's state
    is part of ``state_dict()``: what is loaded from a checkpoint goes on with the next draw.

    Parameters
    ----------
    seed : int
    """

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.generator = torch.Generator().manual_seed(seed)

    def uniform(self, count: int, low: float, high: float) -> Tensor:
        """Draw (count,) float32 in [low, high)."""
        return torch.rand(count, generator=self.generator) * (high - low) + low

    def integers(self, count: int, end: int) -> list[int]:
        """Draw `count` integers in [0, end)."""
        drawn: list[int] = torch.randint(end, (count,), generator=self.generator).tolist()
        return drawn

    def get_extra_state(self) -> Tensor:
        """Return the generator's state, for ``state_dict()``."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Go on from a generator's state."""
        self.generator.set_state(state.cpu())
