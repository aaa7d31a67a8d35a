"""A release of a dataset: how long it takes, whether two are the same, and what verifying finds.

The dataset is released twice, with several processes and with one, and the two are compared byte by
byte. Then one of them is damaged in one place at a time: a flipped bit anywhere in it, a file that
is missing, a file too much. Each time it is verified, and mended again::

    python benchmarks/release.py --dataset DATASET --work WORK --json results/release.json
"""

import argparse
import filecmp
import random
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from measuring import describe_machine, report

from exumi_data.cli.release_judge import judge_with
from exumi_data.release.building import Built, build_release
from exumi_data.release.planning import Wishes, plan_release
from exumi_data.release.verifying import Finding, verify_release

LICENCE = "LicenseRef-benchmark"


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--damages", type=int, default=20, help="Of each kind.")
    arguments = parser.parse_args()
    folder = arguments.work / "release"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "licence.txt").write_text("A benchmark's: not for publication.\n")
    packages = ("exumi-data", "pyarrow", "numpy")
    results: dict[str, Any] = {
        "machine": describe_machine(packages),
        "workers": arguments.workers,
        "dataset": arguments.dataset.name,
    }
    first, second = folder / "first", folder / "second"
    results["first"], built = _release(arguments.dataset, first, arguments.workers)
    results["one_process"], again = _release(arguments.dataset, second, 1)
    results |= {
        "episodes": built.episodes,
        "files": built.files,
        "bytes": built.bytes,
        "preview_episodes": len(built.preview),
        "preview_bytes": built.preview_bytes,
        "identical": _same(first, second) and built.fingerprint == again.fingerprint,
    }
    for name, quick in (("verify_s", False), ("verify_quick_s", True)):
        began = time.perf_counter()
        good = verify_release(first, quick=quick, workers=arguments.workers).good
        results[name] = round(time.perf_counter() - began, 3)
        if not good:
            raise SystemExit(f"{first}: an undamaged release does not verify")
    results["damages"] = _damages(second, arguments.damages, arguments.workers)
    report("release", results, arguments.json)


def _release(dataset: Path, target: Path, workers: int) -> tuple[dict[str, float], Built]:
    judge = judge_with(workers)
    wishes = Wishes(licence=LICENCE, licence_file=target.parent / "licence.txt")
    began = time.perf_counter()
    plan = plan_release(dataset, target, wishes, judge, workers=workers)
    planned = time.perf_counter()
    if plan.problems or plan.judgement.errors:
        raise SystemExit("\n".join((*plan.problems, *plan.judgement.errors)))
    built = build_release(plan, judge, workers=workers)
    ended = time.perf_counter()
    times = {"validate_s": planned - began, "build_s": ended - planned, "all_s": ended - began}
    return {name: round(value, 3) for name, value in times.items()}, built


def _same(first: Path, second: Path) -> bool:
    """Whether two folders have the same files, with the same bytes."""
    names = [
        sorted(path.relative_to(root) for path in root.rglob("*") if path.is_file())
        for root in (first, second)
    ]
    return names[0] == names[1] and all(
        filecmp.cmp(first / name, second / name, shallow=False) for name in names[0]
    )


def _damages(root: Path, count: int, workers: int) -> dict[str, str]:
    order = random.Random(0)  # noqa: S311  # the same damages every time
    files = sorted(
        path for path in root.rglob("*") if path.is_file() and path.name != "manifest.json"
    )
    sizes = [path.stat().st_size for path in files]

    def verified() -> tuple[Finding, ...]:
        return verify_release(root, workers=workers).findings

    found = dict.fromkeys(("changed", "missing", "extra"), 0)
    for _ in range(count):
        (flipped,) = order.choices(files, weights=sizes)
        place, bit = order.randrange(flipped.stat().st_size), 1 << order.randrange(8)
        found["changed"] += _found(root, flipped, "changed", verified, _flipping(place, bit))
        gone = order.choice(files)
        found["missing"] += _found(root, gone, "missing", verified, _removing)
        extra = order.choice(files).with_name("one-too-many.bin")
        found["extra"] += _found(root, extra, "extra", verified, _adding)
    return {name: f"{number} of {count}" for name, number in found.items()}


def _flipping(place: int, bit: int) -> Callable[[Path], Callable[[], object]]:
    def flip(path: Path) -> None:
        with path.open("r+b") as file:
            file.seek(place)
            (value,) = file.read(1)
            file.seek(place)
            file.write(bytes([value ^ bit]))

    def damage(path: Path) -> Callable[[], object]:
        flip(path)
        return lambda: flip(path)

    return damage


def _removing(path: Path) -> Callable[[], object]:
    content = path.read_bytes()
    path.unlink()
    return lambda: path.write_bytes(content)


def _adding(path: Path) -> Callable[[], object]:
    path.write_bytes(b"")
    return path.unlink


def _found(
    root: Path,
    path: Path,
    kind: str,
    verified: Callable[[], tuple[Finding, ...]],
    damage: Callable[[Path], Callable[[], object]],
) -> bool:
    """Whether verifying finds one damage at its very place."""
    mend = damage(path)
    try:
        name = path.relative_to(root).as_posix()
        return any((one.kind, one.path) == (kind, name) for one in verified())
    finally:
        mend()


if __name__ == "__main__":
    main()
