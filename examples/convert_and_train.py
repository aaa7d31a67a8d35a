"""From a folder of touch videos to a trained network: convert, validate, prepare, train.

The videos are simulated, unless you have some: ``<part>_<trial>.mp4`` and a table of ratings::

    python examples/convert_and_train.py WORK                                 makes some
    python examples/convert_and_train.py WORK --source CLIPS --labels CSV     takes yours

The network is small: it looks at what a touch changed in the pad, and says how hard the part is,
from 0 to 10. It says how far it is off on parts that it has never touched, beside one who says the
same of every part. `train_policy.py` and `train_tpp.py` are larger.
"""

import argparse
import csv
import sys
from pathlib import Path

import av
import numpy as np
import torch
from torch import nn

from exumi_converters import ConvertOptions, convert, prepare
from exumi_data.dataset import open_dataset
from exumi_data.errors import ExumiError
from exumi_data.simulation.press import Press, make_parts, simulate_press
from exumi_loaders import PropertyWindows
from exumi_validators import validate

PIXELS = 64


def write_clips(folder: Path, parts: int, trials: int) -> None:
    """Film presses of parts whose hardness is known."""
    folder.mkdir(parents=True)
    with (folder / "labels.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["part_id", "hardness_0_10"])
        for part in make_parts(parts, seed=0):
            table.writerow([part.name, part.hardness])
            for trial in range(trials):
                write_video(folder / f"{part.name}_{trial}.mp4", simulate_press(part, seed=trial))


def write_video(path: Path, press: Press) -> None:
    """Write the frames of a press as MPEG-4, of which nothing is lost that a finger feels."""
    frames = press.frames
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.height, stream.width = frames.shape[1:3]
        stream.bit_rate = 4_000_000
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def make_training_set(work: Path, source: Path, labels: Path) -> Path:
    """Convert, judge and prepare; what is there already is kept."""
    options = ConvertOptions(labels=labels)
    converted = convert(source, work / "dataset", from_format="octopi", options=options)
    for failure in converted.failed:
        print(f"not converted: {failure.name}: {failure.reason}")
    report = validate(work / "dataset")
    print(f"{converted.converted + converted.skipped} episodes, valid: {report.valid}")
    prepare(work / "dataset", work / "training", size=PIXELS)
    return work / "training"


class Small(nn.Module):
    """What a touch changed in the pad, to a rating from 0 to 10."""

    def __init__(self) -> None:
        super().__init__()
        self.look = nn.Sequential(
            nn.Conv2d(3, 16, 5, stride=2),
            nn.ReLU(),
            nn.Conv2d(16, 32, 5, stride=2),
            nn.ReLU(),
            nn.AdaptiveAvgPool2d(4),
            nn.Flatten(),
            nn.Linear(512, 1),
        )

    def forward(self, batch: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return ratings, (N, 1): the mean of what each salient frame says."""
        frames, reference = batch["frames"].float(), batch["reference"].float()
        changed = (frames - reference[:, None]) / 32.0
        said = self.look(changed.flatten(0, 1)).reshape(len(frames), -1)
        rating: torch.Tensor = 5.0 + 5.0 * said.mean(dim=1, keepdim=True)
        return rating


def main() -> None:
    """Run the whole path."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--source", type=Path, help="a folder of clips")
    parser.add_argument("--labels", type=Path, help="a table with part_id and hardness_0_10")
    parser.add_argument("--parts", type=int, default=40, help="parts to simulate")
    parser.add_argument("--epochs", type=int, default=20)
    arguments = parser.parse_args()
    if (arguments.source is None) != (arguments.labels is None):
        parser.error("--source and --labels go together")
    torch.manual_seed(0)
    torch.set_num_threads(1)  # the network is too small for more
    source, labels = arguments.source, arguments.labels
    if source is None:
        source = arguments.work / "clips"
        labels = source / "labels.csv"
        if not source.exists():
            write_clips(source, arguments.parts, trials=3)
    try:
        dataset = open_dataset(make_training_set(arguments.work, source, labels))
        train = PropertyWindows(
            dataset, properties=("hardness",), split="train", split_ratio=(4, 1)
        )
        unseen = PropertyWindows(dataset, properties=("hardness",), split="val", split_ratio=(4, 1))
    except ExumiError as error:
        sys.exit(f"error: {error}")

    network = Small()
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    for epoch in range(arguments.epochs):
        losses = []
        for batch in train.loader(8, shuffle=True):
            loss = (network(batch) - batch["rating"]).abs().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
        print(f"epoch {epoch + 1}: {np.mean(losses):.2f} off")

    batch = unseen.__getitems__(range(len(unseen)))
    with torch.no_grad():
        off = (network(batch) - batch["rating"]).abs().mean()
    same = np.abs(np.median(train.rating) - unseen.rating).mean()
    print(f"{len(train)} clips to train on, {len(unseen)} of parts that were never touched")
    print(f"there the network is {off:.2f} off, and the same rating for all parts {same:.2f}")


if __name__ == "__main__":
    main()
