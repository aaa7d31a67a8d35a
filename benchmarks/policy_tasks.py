"""What touch is worth to a policy: four variants that sort balls by a hardness no camera sees.

The diffusion policy of `examples/touch_policy` is trained on the same demonstrations without touch,
with a tactile encoder that learns with the policy, and with encoders that were trained on play
(BYOL, and prediction of touch) and are frozen. Each then sorts new balls in closed loop, through
`PolicyStream`. Within a seed, all variants are given the same balls::

    python benchmarks/policy_tasks.py --work WORK --json results/policy_tasks.json [--seeds 3]

Each finished run is kept in WORK: start it again to go on, or to add seeds.
"""

import argparse
import json
import sys
import time
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

EXAMPLES = Path(__file__).parents[1] / "examples"
sys.path.insert(0, str(EXAMPLES))

from touch_policy.demonstrations import demonstrate  # noqa: E402
from touch_policy.variants import VARIANTS, Sizes, Variant, make_data, run, wilson  # noqa: E402  # it lies there
from touch_policy.world import TARGET_M, Ball, World, make_senses  # noqa: E402

ASKED = ("success", "gripped", "sorted")


def one_run(work: Path, variant: Variant, sizes: Sizes, seed: int) -> dict[str, Any]:
    """Return the outcomes of one variant and seed; read them if they are there."""
    kept = work / _digest(sizes) / f"{variant}-{seed}.json"
    if kept.exists():
        found: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    start = time.perf_counter()
    data = make_data(work / _digest(sizes), sizes)
    outcomes = run(variant, data, sizes, seed)
    result = {name: [getattr(outcome, name) for outcome in outcomes] for name in ASKED}
    result["seconds"] = [round(time.perf_counter() - start, 1)]
    unfinished = kept.with_suffix(".unfinished")
    unfinished.write_text(json.dumps(result), encoding="utf-8")
    unfinished.rename(kept)
    print(f"{variant} {seed}: {sum(result['success'])} of {len(outcomes)}", file=sys.stderr)
    return result


def _digest(sizes: Sizes) -> str:
    """Return a folder's name for what the runs are made from, code included."""
    digest = sha256(json.dumps(asdict(sizes)).encode())
    for folder in ("touch_policy", "tpp"):
        for file in sorted((EXAMPLES / folder).glob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Pool the attempts of all seeds: rate with Wilson's 95 % interval, and the rate of each."""
    result: dict[str, Any] = {}
    for name in ASKED:
        pooled = [done for one in runs for done in one[name]]
        result[name] = {
            "rate": sum(pooled) / len(pooled),
            "interval": wilson(pooled),
            "seeds": [sum(one[name]) / len(one[name]) for one in runs],
        }
    return result


def table(results: dict[str, Any]) -> str:
    """Return a Markdown table."""
    lines = ["| | success | of each seed | gripped | sorted |", "|---|---|---|---|---|"]
    for variant, found in results.items():
        cells = []
        for name in ASKED:
            low, high = found[name]["interval"]
            cells.append(f"{found[name]['rate']:.0%} ({low:.0%}–{high:.0%})")
        cells.insert(1, ", ".join(f"{rate:.0%}" for rate in found["success"]["seeds"]))
        lines.append(f"| {variant} | {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(file: Path) -> None:
    """Draw a hard and a soft ball as they are gripped: what is seen above, what is felt below."""
    import cv2

    senses = make_senses()
    rows = []
    for give in (0.1, 1.2):
        world = World(Ball(0.024, give, 0.001, 0.0015, 0.0), 0.034)
        shots = [(0.0, senses.rgb(world), senses.tactile(world))]
        for place, width_m in demonstrate(world, np.random.default_rng(1)):
            world.step(place, width_m)
            if world.depth_m > shots[-1][0] + TARGET_M / 3:
                shots.append((world.depth_m, senses.rgb(world), senses.tactile(world)))
        shots.append((world.depth_m, senses.rgb(world), senses.tactile(world)))
        rows += [[seen for _, seen, _ in shots], [felt for _, _, felt in shots]]
    size = (96, 96)
    large = [
        [cv2.resize(one, size, interpolation=cv2.INTER_NEAREST) for one in row] for row in rows
    ]
    picture = np.vstack([np.hstack(row) for row in large])
    cv2.imwrite(str(file), picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def main() -> None:
    """Run the comparison."""
    import torch

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=Path("policy-tasks"))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=VARIANTS)
    parser.add_argument("--steps", type=int, default=Sizes.steps)
    parser.add_argument("--attempts", type=int, default=Sizes.attempts)
    parser.add_argument("--picture", type=Path, help="draw what is seen and felt, and end")
    arguments = parser.parse_args()
    if arguments.picture is not None:
        draw(arguments.picture)
        return
    torch.set_num_threads(1)
    machine = describe_machine(("exumi-data", "numpy", "torch"))
    sizes = replace(Sizes(), steps=arguments.steps, attempts=arguments.attempts)
    runs: dict[Variant, list[dict[str, Any]]] = {variant: [] for variant in arguments.variants}
    for seed in range(arguments.seeds):
        for variant in arguments.variants:
            runs[variant].append(one_run(arguments.work, variant, sizes, seed))
    results: dict[str, Any] = {variant: summary(found) for variant, found in runs.items()}
    seconds = {variant: [one["seconds"][0] for one in found] for variant, found in runs.items()}
    report(
        "policy_tasks",
        {"machine": machine, "sizes": asdict(sizes), "seconds": seconds, "variants": results},
        arguments.json,
    )
    print(table(results))


if __name__ == "__main__":
    main()
