"""How well clips are attached to a session: simulated hub runs with known truth.

Fifty demonstrations a run, one of them without a clip, and one clip of another run; the camera's
clock is off by up to a minute, for all clips alike or for each by its own, and drifts.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

from exumi_recorders.attach import AttachOptions, AttachReport, attach
from exumi_recorders.simulated.hub_run import HubRun, simulate_hub_run

__all__ = ["errors_ms", "main", "one_run"]

_DRIFTS_PPM = (0.0, 43.0, -43.0, 12.0)


def errors_ms(run: HubRun, found: AttachReport) -> np.ndarray:
    """Return for each attached clip the error in its middle and what is claimed of it, (N, 2) ms.

    Parameters
    ----------
    run : HubRun
    found : AttachReport
    """
    rows = []
    for clip in found.clips:
        if clip.start_s is None or clip.sigma_s is None or clip.name not in run.starts_s:
            continue
        middle = 0.5 * clip.duration_s
        drift = 1e-6 * (clip.drift_ppm or 0.0)
        error = clip.start_s + middle * (1.0 + drift) - run.true_s(clip.name, middle)
        rows.append((1e3 * error, 1e3 * clip.sigma_s))
    return np.array(rows).reshape(-1, 2)


def one_run(folder: Path, seed: int, demonstrations: int, seconds: float) -> dict[str, Any]:
    """Simulate a run, attach its clips, and compare with what is true.

    Parameters
    ----------
    folder : pathlib.Path
    seed, demonstrations : int
    seconds : float
        About how long a demonstration is.
    """
    run = simulate_hub_run(
        folder,
        demonstrations=demonstrations,
        seed=seed,
        seconds=seconds,
        drift_ppm=_DRIFTS_PPM[seed % len(_DRIFTS_PPM)],
        one_clock=seed % 2 == 0,
    )
    began = time.perf_counter()
    options = AttachOptions(dry_run=True)
    found = attach(run.clips, run.session, folder / "demos", options=options)
    placed_s = time.perf_counter() - began
    attached = {clip.name for clip in found.clips if clip.status == "placed"}
    near = [
        any(abs(stretch.start_s - start) < 0.6 * seconds for stretch in found.missing)
        for start, _ in run.missing_s
    ]
    return {
        "errors": errors_ms(run, found),
        "belonging": len(run.starts_s),
        "attached": len(attached & set(run.starts_s)),
        "foreign_attached": len(attached & set(run.foreign)),
        "missing_reported": sum(near),
        "stretches_reported": len(found.missing),
        "seconds": placed_s,
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--demonstrations", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=8.0, help="of a demonstration, about")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    machine = describe_machine(("numpy", "scipy", "av"))
    runs = []
    for seed in range(options.runs):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(one_run(Path(folder), seed, options.demonstrations, options.seconds))
    errors, sigma = np.concatenate([run.pop("errors") for run in runs]).T
    totals = {key: sum(run[key] for run in runs) for key in runs[0]}
    results = {
        "runs": len(runs),
        "demonstrations": options.demonstrations,
        "seconds_each": options.seconds,
        **totals,
        "bias_ms": round(float(errors.mean()), 3),
        "rms_ms": round(float(np.sqrt(np.mean(errors**2))), 3),
        "worst_ms": round(float(np.abs(errors).max()), 3),
        "claimed_ms": round(float(np.median(sigma)), 3),
        "within_two_sigma": round(float(np.mean(np.abs(errors) <= 2 * sigma)), 4),
    }
    for key, value in results.items():
        print(f"{key:>20}  {value}")
    report("attach", {"machine": machine, "results": results}, options.json)


if __name__ == "__main__":
    main()
