#!/usr/bin/env python3
"""Spoil stores at random, validate and read each: no crash, no hang, bounded memory.

The same seed gives the same stores. Returns 1 if anything failed; ``--only N`` runs one of them
and prints all about it, ``--keep FOLDER`` writes its store there.
"""

import argparse
import json
import sys
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.fuzz.running import Outcome, run, summary  # noqa: E402  # found by the line above
from tests.fuzz.spoiling import spoiled  # noqa: E402
from tests.fuzz.stores import all_stores  # noqa: E402


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=20_000, help="stores, 20000 unless told")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", type=int, help="one number alone")
    parser.add_argument("--keep", type=Path, help="write the store of --only there")
    parser.add_argument("--json", type=Path, help="write the figures and failures there")
    return parser.parse_args()


class Progress:
    """Says every ten seconds how far a run is."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.done = 0
        self.failed: Counter[str] = Counter()
        self.started = self.told = time.monotonic()

    def __call__(self, outcome: Outcome) -> None:
        """Count an outcome."""
        self.done += 1
        for mistake in outcome.mistakes:
            self.failed[mistake.strip().splitlines()[-1][:150]] += 1
        now = time.monotonic()
        if now - self.told > 10 or self.done == self.total:
            self.told = now
            rate = self.done / (now - self.started)
            failed = sum(self.failed.values())
            text = f"{self.done}/{self.total}, {rate:.0f} a second, {failed} mistakes\n"
            sys.stderr.write(text)


def main() -> int:
    """Run the program."""
    asked = arguments()
    if asked.only is not None:
        if asked.keep:
            asked.keep.mkdir(parents=True, exist_ok=True)
            print(spoiled(all_stores(), asked.seed, asked.only).write(asked.keep))
        (outcome,) = run([asked.only], seed=asked.seed, workers=1)
        for mistake in outcome.mistakes:
            print(mistake)
        print(json.dumps({**asdict(outcome), "mistakes": len(outcome.mistakes)}, indent=1))
        return 1 if outcome.mistakes else 0
    numbers = range(asked.first, asked.first + asked.count)
    tell = Progress(asked.count)
    outcomes = run(numbers, seed=asked.seed, workers=asked.workers, on_done=tell)
    figures = summary(outcomes, asked.seed)
    figures["seconds"] = round(time.monotonic() - tell.started)
    if asked.json:
        asked.json.write_text(json.dumps(figures, indent=1) + "\n")
    print(json.dumps({**figures, "failed": len(figures["failed"])}, indent=1))
    for mistake, count in tell.failed.most_common(40):
        print(f"{count:6} {mistake}")
    return 1 if figures["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
