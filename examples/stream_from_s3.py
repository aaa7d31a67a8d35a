"""Train from object storage: windows of touch from a bucket, nothing downloaded beforehand.

    export AWS_ACCESS_KEY_ID=... AWS_SECRET_ACCESS_KEY=... AWS_REGION=eu-central-1
    python examples/stream_from_s3.py s3://bucket/training-set [--batches 20] [--workers 2]

Any URL that `exumi_data.open` takes works, and so does a local path.
"""

import argparse
import time

import exumi_data
from exumi_loaders import TPPWindows


def main() -> None:
    """Look at a dataset, then load batches of it as a training would."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("--batches", type=int, default=20)
    parser.add_argument("--batch-size", type=int, default=64)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()

    dataset = exumi_data.open(arguments.dataset)
    if not isinstance(dataset, exumi_data.Dataset):
        parser.error("give a dataset, not one episode")
    episode = dataset[0]
    print(
        f"{dataset.path}: {len(dataset)} episodes, {sum(dataset.catalog['bytes'].to_pylist()):,} B"
    )
    for name, stream in episode.streams.items():
        print(f"  {name}: {len(stream)} samples of kind {stream.kind}")

    windows = TPPWindows(dataset)
    start = time.perf_counter()
    done = 0
    loader = windows.loader(arguments.batch_size, num_workers=arguments.workers)
    for batch, _ in zip(loader, range(arguments.batches), strict=False):
        done += len(batch["valid"])
        # Here a training step would be, with the images as bytes: see docs/training.md.
    print(f"{done} of {len(windows)} windows, {done / (time.perf_counter() - start):.0f} a second")


if __name__ == "__main__":
    main()
