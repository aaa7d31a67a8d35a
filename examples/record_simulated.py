"""Record episodes with a simulated rig, and look at what was recorded. No hardware is needed.

The devices are simulated, and speak the real protocols: a headset's poses over UDP, an encoder on
I2C, cameras that give JPEG frames. Everything after them is what records a real rig::

    python examples/record_simulated.py FOLDER [--seconds 3] [--episodes 1]

With a rig of your own, add ``--rig rig.toml``: ``exumi rig init`` writes such a file.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from exumi_data.episode import open_episode
from exumi_data.errors import ExumiError
from exumi_recorders.session.operator import Operator
from exumi_recorders.session.plan import Plan
from exumi_recorders.session.running import open_session
from exumi_validators import validate


def record(folder: Path, rig: str, seconds: float, episodes: int) -> list[Path]:
    """Record episodes one after the other; return where they are."""
    plan = Plan(
        task="stack the cups", duration_s=seconds, auto=True, pause_s=0.5, episodes=episodes
    )
    with Operator(keys=False) as operator, open_session(rig, folder, plan, operator) as session:
        session.run()
    for problem in session.report.problems:
        print(f"problem: {problem}", file=sys.stderr)
    return [one.episode for one in session.report.finished if one.episode is not None]


def describe(path: Path) -> None:
    """Print what each sensor gave: how often, how evenly, and how old its stamps are."""
    with open_episode(path) as episode:
        print(f"{path.name}: {episode.metadata.task.name}, started {episode.metadata.start}")
        for name in episode:
            stream = episode[name]
            apart_ms = np.diff(stream.time) * 1e-6
            rate = 1e3 / np.median(apart_ms)
            clock = stream.metadata.clock
            late_ms = clock.latency_ns / 1e6
            print(
                f"  {name:14} {stream.metadata.kind:8} {len(stream):5} samples, {rate:6.1f} a "
                f"second, at most {apart_ms.max():.1f} ms apart, stamped at {clock.stamp_point}, "
                f"{late_ms:.1f} ms late"
            )


def main() -> None:
    """Record, describe and judge."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="a dataset, new or one to add to")
    parser.add_argument("--rig", default="simulated")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--episodes", type=int, default=1)
    arguments = parser.parse_args()
    try:
        recorded = record(arguments.folder, arguments.rig, arguments.seconds, arguments.episodes)
    except ExumiError as error:
        sys.exit(f"error: {error}")
    for path in recorded:
        describe(path)
    report = validate(arguments.folder)
    for problem in report.problems:
        print(f"{problem.severity}: {problem.message}")
    print("valid" if report.valid else "NOT valid")


if __name__ == "__main__":
    main()
