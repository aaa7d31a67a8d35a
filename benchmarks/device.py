"""Windows per second as floats and on the device: conversion, augmentation, GPU memory, GPU decode.

Of the training sets that ``windows.py`` leaves behind, on one core as long as no GPU takes part::

    python benchmarks/device.py --dataset WORK/windows-grey --json results/device.json

Where there is no CUDA device, or no torchvision, the rows that need it say so.
"""

import argparse
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import torch
from measuring import Timing, describe_machine, one_core, report, timed
from torch import nn

from exumi_data.dataset import open_dataset
from exumi_data.errors import MissingExtraError
from exumi_loaders import (
    Blur,
    ColourJitter,
    DecodeJpeg,
    Mirror,
    RandomCrop,
    Resize,
    ToFloat,
    TPPWindows,
    prefetch_to_device,
)

Loader = Iterable[dict[str, Any]]


def make_windows(dataset: Path, **options: Any) -> TPPWindows:
    """Open a training set as windows."""
    return TPPWindows(open_dataset(dataset), edges="drop", cache=False, **options)


def run(make: Callable[[], Loader], count: int, repeats: int) -> Timing:
    """Measure windows/s of an epoch's first `count` windows."""

    def once() -> int:
        done = 0
        for batch in make():
            done += len(batch["valid"])
            if done >= count:
                break
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        return done

    once()
    return timed(once, repeats)


def naive(batch: dict[str, Any]) -> dict[str, Any]:
    """Convert as one would without thinking of memory."""
    return {
        name: (value.contiguous().float() / 255) if value.dtype == torch.uint8 else value
        for name, value in batch.items()
    }


def on_cpu(windows: TPPWindows, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure the loader with each conversion, in this process."""

    def through(transform: Callable[[Any], Any] | None) -> Timing:
        return run(
            lambda: prefetch_to_device(windows.loader(arguments.batch), "cpu", transform=transform),
            arguments.windows,
            arguments.repeats,
        )

    rows = {
        "uint8": through(None),
        "float32": through(ToFloat()),
        "float32_chw": through(ToFloat(memory="contiguous")),
        "float32_chw_naive": through(naive),
    }
    return {"windows_per_s": rows}


def modules_alone(windows: TPPWindows, arguments: argparse.Namespace, device: str) -> Any:
    """Measure each module on one batch that lies on the device already."""
    batch = windows.__getitems__(list(range(arguments.batch)))
    moved = {name: value.to(device) for name, value in batch.items()}
    floats = ToFloat()(moved)
    sensors = dict.fromkeys(windows.layout.tactile, "gelsight-mini")
    modules: dict[str, tuple[nn.Module, dict[str, Any]]] = {
        "ToFloat": (ToFloat(), moved),
        "RandomCrop": (RandomCrop(200), floats),
        "Resize": (Resize(112), floats),
        "ColourJitter": (ColourJitter(), floats),
        "Blur": (Blur(p=0.5), floats),
        "Mirror": (Mirror(sensors, any_light=True), floats),
    }
    return {
        name: run(lambda m=module, b=given: [m(b)], arguments.batch, arguments.repeats)  # type: ignore[misc]  # bound now
        for name, (module, given) in modules.items()
    }


def on_gpu(dataset: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure end to end into GPU memory, and decoding there."""
    if not torch.cuda.is_available():
        return {"skipped": "there is no CUDA device"}
    windows = make_windows(dataset)
    files = make_windows(dataset, decode="device")

    def into_memory(source: TPPWindows, workers: int, *modules: nn.Module) -> Timing:
        options: dict[str, Any] = {"num_workers": workers}
        transform = nn.Sequential(*modules, ToFloat())
        return run(
            lambda: prefetch_to_device(
                source.loader(arguments.batch, **options), "cuda", transform=transform
            ),
            arguments.windows,
            arguments.repeats,
        )

    workers = (0, 1, 2, arguments.workers)
    rows: dict[str, Any] = {
        "device": torch.cuda.get_device_name(),
        "into_memory_windows_per_s": {str(n): into_memory(windows, n) for n in workers},
        "modules_alone_windows_per_s": modules_alone(windows, arguments, "cuda"),
    }
    try:
        decode = DecodeJpeg("cuda")
    except MissingExtraError as error:
        return {**rows, "decoded_there_windows_per_s": {"skipped": str(error)}}
    rows["decoded_there_windows_per_s"] = {str(n): into_memory(files, n, decode) for n in workers}
    rows["decoded_there_difference"] = differences(windows, files, decode, arguments.batch)
    return rows


def differences(windows: TPPWindows, files: TPPWindows, decode: DecodeJpeg, batch: int) -> Any:
    """Compare pixels that the GPU decoded with those of the CPU, in grey levels."""
    indices = list(range(batch))
    here, there = windows.__getitems__(indices), decode(files.__getitems__(indices))
    found = {}
    for name in windows.layout.images:
        apart = (there[name].cpu().int() - here[name].int()).abs()
        found[name] = {"largest": int(apart.max()), "mean": round(float(apart.float().mean()), 4)}
    return found


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True, action="append")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--windows", type=int, default=4000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--workers", type=int, default=8)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "numpy", "simplejpeg", "torch", "torchvision"))
    results = {}
    for dataset in arguments.dataset:
        cores = one_core()
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        windows = make_windows(dataset)
        results[dataset.name] = {
            "cpu": on_cpu(windows, arguments),
            "cpu_modules_alone_windows_per_s": modules_alone(windows, arguments, "cpu"),
        }
        os.sched_setaffinity(0, cores)
        torch.set_num_threads(threads)
        results[dataset.name]["gpu"] = on_gpu(dataset, arguments)
    report("device", {"machine": machine, **results}, arguments.json)


if __name__ == "__main__":
    main()
