"""A minimal diffusion policy: images, touch and poses in, a stretch of actions out."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from exumi_loaders import Normaliser, PolicyWindows, TactileRepresentation
from exumi_loaders.policy_spec import PolicySpec
from touch_policy.diffusion import Denoiser
from touch_policy.encoders import FrozenEncoder, TactileEncoder

__all__ = ["DiffusionPolicy", "train_policy"]


_SEEN = 32
_BATCH = 32
_AVERAGED = 0.99

Batch = Mapping[str, Tensor]


class DiffusionPolicy(nn.Module):
    """Draws actions; what it is given are the features of all observed steps, concatenated.

    Parameters
    ----------
    spec : PolicySpec
        With one camera, and one tactile stream.
    normaliser : Normaliser
    touch : TactileEncoder or FrozenEncoder, optional
        Of tactile images; without it the policy does not feel.
    """

    def __init__(
        self,
        spec: PolicySpec,
        normaliser: Normaliser,
        touch: TactileEncoder | FrozenEncoder | None,
    ) -> None:
        super().__init__()
        self.normaliser, self.touch = normaliser, touch
        self._camera, self._finger = spec.rgb[0], spec.tactile[0]
        self._shape = len(spec.action_steps), len(spec.action_columns)
        self.represent = TactileRepresentation()
        self.see = nn.Sequential(
            nn.Conv2d(3, 16, 4, stride=4),
            nn.SiLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.SiLU(),
            nn.Conv2d(32, 32, 3, stride=2, padding=1),
            nn.SiLU(),
            nn.Flatten(),
            nn.Linear(32 * 9, _SEEN),
        )
        features = _SEEN + self._shape[1] + (touch.size if touch else 0)
        steps = len(spec.observation_steps)
        self.denoiser = Denoiser(self._shape[0] * self._shape[1], steps * features)

    def loss(self, batch: Batch) -> Tensor:
        """Compute the squared error of estimated actions, over those that are valid."""
        batch = self.normaliser.normalise(batch)
        error = self.denoiser.error(batch["action"].flatten(1), self._context(batch))
        valid = batch["action_valid"][..., None]
        total = (error.view_as(batch["action"]) * valid).sum()
        return torch.as_tensor(total / valid.sum() / self._shape[1])

    @torch.no_grad()
    def act(self, observation: Batch) -> Tensor:
        """Draw actions (B, A, D) as `PolicyWindows` has them, given a batch of observations."""
        context = self._context(self.normaliser.normalise(observation))
        action = self.denoiser.draw(context).unflatten(1, self._shape)
        return self.normaliser.unnormalise({"action": action})["action"]

    def _context(self, batch: Batch) -> Tensor:
        images = batch[self._camera]
        parts = [self._each(self.see, images / 255), batch["proprioception"]]
        if self.touch is not None:
            touch = self.represent(batch[self._finger], batch[f"{self._finger}_reference"])
            parts.append(self._each(self.touch, touch))
        return torch.cat(parts, dim=-1).flatten(1)

    @staticmethod
    def _each(network: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
        """Apply a network to each step of (B, n, C, H, W)."""
        return torch.as_tensor(network(images.flatten(0, 1)).unflatten(0, images.shape[:2]))


def train_policy(
    policy: DiffusionPolicy, windows: PolicyWindows, steps: int, seed: int
) -> DiffusionPolicy:
    """Train for a number of steps, and return the moving average of the weights.

    Parameters
    ----------
    policy : DiffusionPolicy
    windows : PolicyWindows
    steps, seed : int
    """
    torch.manual_seed(seed)
    learning = [weight for weight in policy.parameters() if weight.requires_grad]
    optimizer = torch.optim.AdamW(learning, lr=1e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    averaged = torch.optim.swa_utils.AveragedModel(
        policy, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(_AVERAGED)
    )
    memory = windows.__getitems__(range(len(windows)))  # small: it is decoded once
    for _ in range(steps):
        chosen = torch.randint(len(windows), (_BATCH,))
        loss = policy.loss({name: value[chosen] for name, value in memory.items()})
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        averaged.update_parameters(policy)
    trained = averaged.module
    assert isinstance(trained, DiffusionPolicy)  # noqa: S101  # as it was given
    return trained.eval()
