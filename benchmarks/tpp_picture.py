"""Draw predictions of held-out windows, from the runs that `tpp_masks.py` has kept.

After it::

    python benchmarks/tpp_picture.py --work WORK --out docs/images/tpp.png
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tpp_masks import Settings, Trainer, build

from exumi_data.demo.canvas import Canvas

CELL, GAP, LEFT, TOP, BETWEEN = 72, 6, 200, 62, 30
INK, QUIET, GROUND = (30, 34, 40), (110, 116, 124), (255, 255, 255)
SHOWN = ("none", "action", "tactile_history")
NAMES = {
    "none": "all inputs",
    "action": "without action",
    "tactile_history": "without touch so far",
}


def grey(image: Tensor) -> np.ndarray:
    """Return the left finger's picture: lighter where it is convex, darker where concave."""
    shade = 0.5 + 0.5 * (image[1] - image[2]).clamp(-1, 1)
    pixels = (shade * 255).round().to(torch.uint8).numpy()
    return np.repeat(pixels[..., None], 3, axis=2)


def choose(touch: Tensor, history: int) -> list[int]:
    """Choose windows: the hand closes on something, lets go of it, and holds it all the time.

    Of each kind the one whose contact is of median strength.
    """
    strength = touch[:, :, 1:3].mean(dim=(2, 3, 4))
    before, after = strength[:, :history], strength[:, history:]
    closes = after[:, -1] - 3 * before.amax(1)
    opens = before[:, -1] - 3 * after[:, -1]
    holds = torch.minimum(before.amin(1), after.amin(1)) - 3 * strength.min()
    return [_median(values) for values in (closes, opens, holds)]


def _median(values: Tensor) -> int:
    """Return where the median of the positive values lies."""
    positive = torch.nonzero(values > 0)[:, 0]
    return int(positive[values[positive].argsort()[len(positive) // 2]])


def draw(sample: Any, predictions: dict[str, Tensor], chosen: list[int], history: int) -> Canvas:
    """Draw a block of rows for each chosen window."""
    frames = sample.touch.shape[1]
    rows = 1 + len(predictions)
    step = CELL + GAP
    block = rows * step + BETWEEN
    canvas = Canvas(LEFT + frames * step + 24, TOP + len(chosen) * block - 8, GROUND)

    def place(column: int, line: int, window: int) -> tuple[float, float, float, float]:
        return (
            LEFT + column * step + (column >= history) * 12,
            window * block + TOP + line * step,
            CELL,
            CELL,
        )

    canvas.text((LEFT, 26), "felt so far", size=20, color=INK, weight=600)
    canvas.text((place(history, 0, 0)[0], 26), "to come", size=20, color=INK, weight=600)
    for window, index in enumerate(chosen):
        for column in range(frames):
            x, y, *_ = place(column, 0, window)
            label = f"{50 * int(sample.steps[index, column])} ms"
            canvas.text((x, y - 8), label, size=15, color=QUIET)
            canvas.image((x, y, CELL, CELL), grey(sample.touch[index, column]))
        lines = {"truth": sample.touch[index, history:]}
        lines |= {NAMES[mask]: images[index] for mask, images in predictions.items()}
        for line, (name, images) in enumerate(lines.items()):
            _, y, *_ = place(0, line, window)
            canvas.text((LEFT - 14, y + 42), name, size=18, color=INK, align="right")
            for column, image in enumerate(images, start=history):
                canvas.image(place(column, line, window), grey(image))
    return canvas


def main() -> None:
    """Draw one future for each chosen window and mask."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    settings = Settings()
    trainer = Trainer(build(arguments.work, settings), settings)
    history = trainer.held_out.windows.steps.history_frames
    sample = trainer.held_out.read(trainer.indices)
    chosen = choose(sample.touch, history)
    predictions = {}
    for mask in SHOWN:
        model = trainer.model(arguments.seed)
        name = f"{mask}-{arguments.seed}.pt"
        path = arguments.work / settings.digest / name
        model.load_state_dict(torch.load(path, weights_only=True))
        model.eval()
        masked = trainer.samples("val", mask).read(trainer.indices)
        shape = (*masked.touch[:, history:].shape[:2], model.sizes.latent)
        noise = torch.randn(shape, generator=torch.Generator().manual_seed(0))
        predictions[mask], _ = model.predict(masked, noise, settings.diffusion_steps)
    draw(sample, predictions, chosen, history).save(arguments.out)


if __name__ == "__main__":
    main()
