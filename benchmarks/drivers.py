"""What recording the encoder and the taxels costs, and how well they keep their time.

The encoder's chip is simulated in the same process, and its share is counted; the taxels come from
another process over a pseudo-terminal, as from a device::

    python benchmarks/drivers.py --seconds 10 --json results/drivers.json
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

from exumi_recorders.contract import Driver, Sample
from exumi_recorders.drivers.as5600 import As5600, As5600Options, SimulatedEncoder
from exumi_recorders.drivers.tac02 import Tac02, Tac02Options
from exumi_recorders.simulated.play import SimulatedPlay
from exumi_recorders.simulated.tac02 import SimulatedTac02

_TIMEOUT_S = 0.05


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    seconds = arguments.seconds
    play = SimulatedPlay(seed=1, duration_s=seconds + 20.0, epoch_ns=time.monotonic_ns())
    play.session()
    results: dict[str, Any] = {
        "machine": describe_machine(("exumi-data", "numpy", "pyserial")),
        "seconds": seconds,
    }
    for rate_hz in (500, 1000):
        options = As5600Options(rate_hz=rate_hz, simulated=_encoder(play))
        results[f"as5600_{rate_hz}"] = _measured(lambda o=options: As5600(o), rate_hz, seconds)  # type: ignore[misc]  # mypy cannot infer a default's type
    with (
        tempfile.TemporaryDirectory() as folder,
        SimulatedTac02(play, "left", Path(folder) / "tac", rate_hz=1000) as device,
    ):
        taxels = Tac02Options(side="left", port=device.port)
        results["tac02_1000"] = _measured(lambda: Tac02(taxels), 1000, seconds)
    report("drivers", results, arguments.json)


def _encoder(play: SimulatedPlay) -> SimulatedEncoder:
    return SimulatedEncoder(**play.model_dump())


def _measured(make: Callable[[], Driver], rate_hz: int, seconds: float) -> dict[str, Any]:
    """Return the share of a core, and how samples lie in time."""
    driver = make()
    driver.open()
    times_ns: list[int] = []
    ages_ns: list[int] = []
    busy_s, start_s = time.process_time(), time.monotonic()
    while time.monotonic() - start_s < seconds:
        items = driver.read(_TIMEOUT_S)
        now_ns = time.monotonic_ns()
        stamps = [item.time_host_ns for item in items if isinstance(item, Sample)]
        times_ns += stamps
        ages_ns += [now_ns - stamp for stamp in stamps]
    busy_s, took_s = time.process_time() - busy_s, time.monotonic() - start_s
    health = driver.health()
    driver.close()
    steps_ms = np.diff(times_ns) / 1e6
    return {
        "samples": len(times_ns),
        "expected": int(took_s * rate_hz),
        "lost": dict(health.lost),
        "percent_of_a_core": round(100 * busy_s / took_s, 1),
        "step_ms": _quantiles(steps_ms),
        "age_at_hand_over_ms": _quantiles(np.array(ages_ns) / 1e6),
        "stamp_sigma_us": None
        if health.stamp_sigma_ns is None
        else round(health.stamp_sigma_ns / 1000, 1),
    }


def _quantiles(values: np.ndarray) -> dict[str, float]:
    names = ("median", "p99", "most")
    found = np.quantile(values, (0.5, 0.99, 1.0))
    return {name: round(float(value), 3) for name, value in zip(names, found, strict=True)}


if __name__ == "__main__":
    main()
