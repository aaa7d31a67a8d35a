"""From windows to what the model takes: representation, size, and what is seen of it."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from exumi_loaders import ActiveWindowSampler, TactileRepresentation, TPPWindows

__all__ = ["Sample", "Samples", "Scales", "measure"]

Batch = dict[str, Tensor]


@dataclass(frozen=True)
class Sample:
    """A batch on the device. F fingers, K tactile frames, N images, S steps.

    Attributes
    ----------
    touch : Tensor
        (B, K, 3F, side, side) float32: grey, convex and concave of one finger after the other;
        history first, then future.
    touch_seen : Tensor
        (B, K) bool: the frame is there for all fingers, and not masked.
    steps : Tensor
        (B, K) int64: step of each tactile frame.
    image, image_seen : Tensor
        (B, N, 3, side, side) float32 and (B, N) bool.
    action, action_seen : Tensor
        (B, S, A) float32, as in the windows, and (B, S) bool. A may be 0.
    """

    touch: Tensor
    touch_seen: Tensor
    steps: Tensor
    image: Tensor
    image_seen: Tensor
    action: Tensor
    action_seen: Tensor


class Samples:
    """Turns batches of `TPPWindows` into samples on a device.

    Parameters
    ----------
    windows : TPPWindows
        With a reference image for each tactile stream.
    side : int
        Height and width to resize to, pixels.
    device : str
    """

    def __init__(self, windows: TPPWindows, side: int, device: str) -> None:
        self.windows = windows
        self._side, self._device = side, device
        self._represent = TactileRepresentation().to(device)

    def draw(self, batch_size: int, batches: int, seed: int) -> Iterator[Sample]:
        """Yield random batches of active windows: a function of the seed, whatever is masked."""
        sampler = ActiveWindowSampler(self.windows, count=batch_size * batches, seed=seed)
        for batch in self.windows.loader(batch_size, sampler=sampler):
            yield self._sample(batch)

    def read(self, indices: list[int]) -> Sample:
        """Read windows by index."""
        return self._sample(self.windows.__getitems__(indices))

    def _sample(self, batch: Batch) -> Sample:
        layout = self.windows.layout
        touch = torch.cat([self._touch(batch, name) for name in layout.tactile], dim=2)
        seen = torch.stack([batch[f"{name}_valid"] for name in layout.tactile]).all(dim=0)
        count, steps = len(seen), batch["padding"].shape[1]
        images = [self._small(batch[name].to(self._device) / 255) for name in layout.rgb]
        images_seen = [batch[f"{name}_valid"] for name in layout.rgb]
        side = (self._side, self._side)
        none_image = torch.zeros(count, 0, 3, *side, device=self._device)
        none_seen = torch.zeros(count, 0, dtype=torch.bool)
        action = batch.get("action", torch.zeros(count, steps, 0))
        action_seen = batch.get("action_valid", torch.zeros(count, steps, dtype=torch.bool))
        return Sample(
            touch,
            seen.to(self._device),
            batch["tactile_steps"].to(self._device),
            torch.cat([none_image, *images], dim=1),
            torch.cat([none_seen, *images_seen], dim=1).to(self._device),
            action.to(self._device),
            action_seen.to(self._device),
        )

    def _touch(self, batch: Batch, name: str) -> Tensor:
        """Return the representation of one finger, (B, K, 3, side, side)."""
        frames = batch[name].to(self._device)  # uint8 until here
        return self._small(self._represent(frames, batch[f"{name}_reference"].to(self._device)))

    def _small(self, images: Tensor) -> Tensor:
        if images.shape[-2:] == (self._side, self._side):
            return images
        size = (self._side, self._side)
        flat = nn.functional.interpolate(images.flatten(0, 1), size, mode="area")
        return flat.view(*images.shape[:2], *flat.shape[1:])


@dataclass(frozen=True)
class Scales:
    """What brings inputs to about zero mean and unit spread.

    Attributes
    ----------
    touch, touch_spread : Tensor
        (3F, side, side): the mean tactile image; (): the spread about it.
    action, action_spread, change : Tensor
        (A,): mean and spread of actions, and spread of their changes from step to step.
    """

    touch: Tensor
    touch_spread: Tensor
    action: Tensor
    action_spread: Tensor
    change: Tensor


def measure(samples: Samples, count: int = 512) -> Scales:
    """Measure windows that lie evenly in a dataset.

    Parameters
    ----------
    samples : Samples
        Without a mask.
    count : int
        Windows at most.
    """
    total = len(samples.windows)
    indices = torch.linspace(0, total - 1, min(count, total)).long().tolist()
    sample = samples.read(indices)
    touch = sample.touch.mean(dim=(0, 1))
    action, seen = sample.action, sample.action_seen
    change = action.diff(dim=1)[seen[:, 1:] & seen[:, :-1]]
    return Scales(
        touch,
        (sample.touch - touch).square().mean().sqrt().clamp_min(1e-4),
        action[seen].mean(0),
        _spread(action[seen]).clamp_min(1e-4),
        _spread(change).clamp_min(1e-6),
    )


def _spread(values: Tensor) -> Tensor:
    """Return the spread of each column of (N, A) values; 1 where there is nothing to measure."""
    return values.std(0) if len(values) > 1 else torch.ones(values.shape[1])
