"""Predict touch: train a very small network on tactile windows.

From the last four tactile frames and the actions to come, predict the four frames to come. Small
enough for a CPU; the loop, not the network, is what this shows::

    python examples/train_tpp.py DATASET [--steps 50]
"""

import argparse

import torch
from torch import Tensor, nn

import exumi_data
from exumi_loaders import TactileRepresentation, TPPWindows

HISTORY, FUTURE, SIDE = 4, 4, 64


class TouchPredictor(nn.Module):
    """Four frames of history and 32 actions in, four frames of future out."""

    def __init__(self, channels: int, action_size: int) -> None:
        super().__init__()
        self.see = nn.Sequential(
            nn.Conv2d(HISTORY * channels, 32, 5, stride=4, padding=2),
            nn.GELU(),
            nn.Conv2d(32, 64, 5, stride=4, padding=2),
            nn.GELU(),
        )
        self.act = nn.Linear(32 * action_size, 64) if action_size else None
        self.draw = nn.Sequential(
            nn.ConvTranspose2d(64, 32, 4, stride=4),
            nn.GELU(),
            nn.ConvTranspose2d(32, FUTURE * channels, 4, stride=4),
        )

    def forward(self, history: Tensor, action: Tensor | None) -> Tensor:
        """Predict (B, 4·C, 64, 64) from (B, 4·C, 64, 64) and (B, 32, A)."""
        features = self.see(history)
        if self.act is not None and action is not None:
            features = features + self.act(action.flatten(1))[..., None, None]
        return torch.as_tensor(self.draw(features))


def main() -> None:
    """Train for a few steps and print the loss."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--batch-size", type=int, default=16)
    arguments = parser.parse_args()
    torch.manual_seed(0)
    device = "cuda" if torch.cuda.is_available() else "cpu"

    dataset = exumi_data.open(arguments.dataset)
    if not isinstance(dataset, exumi_data.Dataset):
        parser.error("give a dataset, not one episode")
    windows = TPPWindows(dataset, split="train", rgb=[], grey_tactile=True)
    finger = windows.layout.tactile[0]
    print(windows, f"- {windows.active.mean():.0%} of them active")

    represent = TactileRepresentation().to(device)
    action_size = windows[0]["action"].shape[-1] if "action" in windows[0] else 0
    model = TouchPredictor(3, action_size).to(device)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3)
    step = 0
    while step < arguments.steps:
        for batch in windows.loader(arguments.batch_size, reject_inactive=0.9):
            frames = batch[finger].to(device)  # uint8 until here
            touch = represent(frames, batch[f"{finger}_reference"].to(device))
            touch = nn.functional.interpolate(touch.flatten(0, 1), (SIDE, SIDE), mode="area")
            touch = touch.view(*frames.shape[:2], 3, SIDE, SIDE)
            action = batch["action"].to(device) if action_size else None
            predicted = model(touch[:, :HISTORY].flatten(1, 2), action)
            loss = nn.functional.mse_loss(predicted, touch[:, HISTORY:].flatten(1, 2))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            if step % 10 == 0:
                print(f"step {step:4d}  loss {loss.item():.4f}")
            step += 1
            if step >= arguments.steps:
                break


if __name__ == "__main__":
    main()
