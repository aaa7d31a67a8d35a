"""Which inputs tactile prediction needs: five masks, several seeds, paired.

A simulated hand taps on objects at random times and to random depths before it picks them up, so
what will be felt is decided by the fingers. `examples/tpp` is trained on it once for each mask and
seed, with the same initial weights, windows and noise for all masks of a seed, and judged on grasps
that were held out::

    python benchmarks/tpp_masks.py --work WORK --json results/tpp_masks.json [--workers 2]

Each finished run is kept in WORK: start it again to go on, or to add seeds. Runs of other settings,
or of another version of the example, are kept apart. ``--picture FILE`` draws predictions.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report
from paired import over_groups, over_seeds

EXAMPLES = Path(__file__).parents[1] / "examples"
sys.path.insert(0, str(EXAMPLES))

MASKS = ("none", "rgb", "action", "action+rgb", "tactile_history")
ERRORS = ("sample", "mean", "latent")


@dataclass(frozen=True)
class Settings:
    """What a run is made from, beside its mask and seed."""

    seconds: float = 900.0
    taps: int = 4
    frame_width: int = 128
    side: int = 32
    ratio: tuple[int, int] = (3, 1)
    steps: int = 1000
    batch_size: int = 32
    held_out_stride: int = 8
    draws: int = 4
    diffusion_steps: int = 8

    @property
    def data(self) -> str:
        """What the dataset is made from, as a folder's name."""
        return f"play-{self.seconds:g}s-{self.taps}taps-{self.frame_width}px-{self.side}px"

    @property
    def digest(self) -> str:
        """What the runs are made from, code included, as a folder's name."""
        found = sha256(json.dumps(asdict(self)).encode())
        for path in sorted((EXAMPLES / "tpp").glob("*.py")):
            found.update(path.read_bytes())
        return f"runs-{found.hexdigest()[:12]}"


def build(work: Path, settings: Settings) -> Path:
    """Simulate play and prepare it; made once."""
    from exumi_converters import prepare
    from exumi_data.demo import DemoSettings, write_play_dataset

    raw, target = work / f"{settings.data}-raw", work / settings.data
    if not (target / "catalog.parquet").exists():
        if not (raw / "catalog.parquet").exists():
            size = {"taps": settings.taps, "frame_width": settings.frame_width}
            write_play_dataset(raw, DemoSettings(seconds=settings.seconds, **size))
        prepare(raw, target, size=settings.side, gray=True)
    return target


class Trainer:
    """Trains and judges, one mask and seed at a time.

    Attributes
    ----------
    held_out : Samples
        Nothing masked; history frames are fixed, so that all runs see the same.
    indices : list of int
        The held-out windows that are judged: active, and wholly inside their grasp.
    """

    def __init__(self, folder: Path, settings: Settings) -> None:
        import torch

        from exumi_data.dataset import open_dataset

        torch.set_num_threads(1)
        self._settings = settings
        self._dataset = open_dataset(folder)
        self._whole = self.samples("train", "none")
        self.held_out = self.samples("val", "none")
        active = np.flatnonzero(self.held_out.windows.active)
        self.indices = active[:: settings.held_out_stride].tolist()

    def samples(self, split: str, mask: Any) -> Any:
        """Return samples of a split, with a mask."""
        from tpp.data import Samples

        from exumi_loaders import TPPWindows

        training = split == "train"
        windows = TPPWindows(
            self._dataset,
            split=split,
            split_ratio=self._settings.ratio,
            random_history=training,
            edges="pad" if training else "drop",
            mask=mask,
        )
        return Samples(windows, self._settings.side, "cpu")

    def model(self, seed: int) -> Any:
        """Make an untrained model."""
        from tpp.predictor import Sizes
        from tpp.training import make_predictor

        return make_predictor(Sizes.small(), self._whole, seed)

    def run(self, mask: str, seed: int, weights: Path) -> dict[str, Any]:
        """Train once, keep the weights, and return the errors by held-out grasp."""
        import torch
        from tpp.evaluation import evaluate
        from tpp.training import train

        settings = self._settings
        began = time.perf_counter()
        model = self.model(seed)
        train(
            model,
            self.samples("train", mask),
            steps=settings.steps,
            batch_size=settings.batch_size,
            seed=seed,
        )
        trained = time.perf_counter()
        found = evaluate(
            model,
            self.samples("val", mask),
            self.indices,
            draws=settings.draws,
            steps=settings.diffusion_steps,
        )
        torch.save(model.state_dict(), weights)
        errors = {name: self.by_grasp(values) for name, values in asdict(found).items()}
        return {
            "mask": mask,
            "seed": seed,
            "errors": errors,
            "training_s": round(trained - began, 1),
            "judging_s": round(time.perf_counter() - trained, 1),
        }

    def guesses(self) -> dict[str, Any]:
        """Return the errors of guesses that need no training, by held-out grasp."""
        from tpp.evaluation import baselines

        found = baselines(self.held_out, self.indices, self.model(0).vae.average)
        return {name: self.by_grasp(values) for name, values in found.items()}

    def by_grasp(self, values: np.ndarray) -> list[float]:
        """Average the errors of windows by held-out grasp."""
        grasp = self.held_out.windows.__getitems__(self.indices)["episode"].numpy()
        return [float(values[grasp == number].mean()) for number in np.unique(grasp)]


def one_run(job: tuple[str, int], *, data: Path, runs: Path, settings: Settings) -> str:
    """Make one run unless it is there, in a process of its own."""
    mask, seed = job
    name = f"{mask.replace('+', '-')}-{seed}"
    path = runs / f"{name}.json"
    if not path.exists():
        result = Trainer(data, settings).run(mask, seed, runs / f"{name}.pt")
        path.write_text(json.dumps(result), encoding="utf-8")
    return name


def summarise(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Compare each mask with no mask: over seeds, and over held-out grasps."""
    by_mask: dict[str, dict[int, dict[str, Any]]] = {mask: {} for mask in MASKS}
    for run in runs:
        by_mask[run["mask"]][run["seed"]] = run["errors"]
    seeds = sorted(set.intersection(*(set(found) for found in by_mask.values())))
    out: dict[str, Any] = {"seeds": seeds, "masks": {}}
    table = {
        mask: {
            name: np.array([by_mask[mask][seed][name] for seed in seeds])
            for name in (*ERRORS, "floor")
        }
        for mask in MASKS
    }
    for mask in MASKS:
        row: dict[str, Any] = {}
        for name, values in table[mask].items():
            row[name] = {"mean": float(values.mean()), "by_seed": values.mean(axis=1).tolist()}
            if mask != "none" and name in ERRORS:
                more = values - table["none"][name]
                row[name]["more_than_none"] = float(more.mean())
                row[name]["95_over_seeds"] = over_seeds(more.mean(axis=1))
                row[name]["95_over_grasps"] = over_groups(more.mean(axis=0))
        out["masks"][mask] = row
    return out


def print_table(summary: dict[str, Any], guesses: dict[str, Any]) -> None:
    """Print the errors in thousandths, and how much larger they are than with all inputs."""
    print(f"\nmean squared errors x 1000, {len(summary['seeds'])} seeds")
    print("left out          one draw   mean of draws   latent   one draw: more than none (95 %)")
    for mask, row in summary["masks"].items():
        line = f"{mask:16s}  {row['sample']['mean'] * 1e3:8.3f}  {row['mean']['mean'] * 1e3:14.3f}"
        line += f"  {row['latent']['mean']:7.3f}"
        if mask != "none":
            low, high = row["sample"]["95_over_seeds"]
            low_g, high_g = row["sample"]["95_over_grasps"]
            line += f"   {row['sample']['more_than_none'] * 1e3:.3f}"
            line += f" (seeds {low * 1e3:.3f} to {high * 1e3:.3f},"
            line += f" grasps {low_g * 1e3:.3f} to {high_g * 1e3:.3f})"
        print(line)
    for name, values in guesses.items():
        print(f"{name + ' (guess)':16s}  {np.mean(values) * 1e3:8.3f}")
    floor = np.mean([row["floor"]["mean"] for row in summary["masks"].values()])
    print(f"{'the VAE alone':16s}  {floor * 1e3:8.3f}")


def main() -> None:
    """Make the data and the runs that are missing, and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--steps", type=int, default=Settings.steps)
    parser.add_argument("--seconds", type=float, default=Settings.seconds)
    arguments = parser.parse_args()
    settings = Settings(steps=arguments.steps, seconds=arguments.seconds)
    machine = describe_machine(("exumi-data", "torch", "numpy"))
    data = build(arguments.work, settings)
    runs = arguments.work / settings.digest
    runs.mkdir(parents=True, exist_ok=True)
    jobs = [(mask, seed) for seed in range(arguments.seeds) for mask in MASKS]
    make = partial(one_run, data=data, runs=runs, settings=settings)
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        for name in pool.map(make, jobs):
            print(name, flush=True)
    trainer = Trainer(data, settings)
    guesses = trainer.guesses()
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(runs.glob("*.json"))]
    summary = summarise(found)
    results = {
        "machine": machine,
        "settings": asdict(settings),
        "held_out_windows": len(trainer.indices),
        "held_out_grasps": len(guesses["copy"]),
        "training_s": float(np.median([run["training_s"] for run in found])),
        **summary,
        "guesses": {name: float(np.mean(values)) for name, values in guesses.items()},
    }
    report("tpp_masks", results, arguments.json)
    print_table(summary, guesses)


if __name__ == "__main__":
    main()
