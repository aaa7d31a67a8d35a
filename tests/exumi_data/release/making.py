"""A release made as the command line makes it."""

from collections.abc import Callable
from pathlib import Path

from exumi_data.cli.release_judge import judge_with
from exumi_data.release.building import Built
from exumi_data.release.planning import Plan, Wishes, plan_release

LICENCE = "LicenseRef-tests"
Release = Callable[..., Built]


def planned(source: Path, target: Path, **wishes: object) -> Plan:
    """Plan a release."""
    chosen = Wishes(**{"licence": LICENCE, **wishes})  # type: ignore[arg-type]  # of each test
    return plan_release(source, target, chosen, judge_with(1), workers=1)


def tree(root: Path) -> dict[str, bytes]:
    """Every file of a folder, hidden ones too."""
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in root.rglob("*")
        if path.is_file()
    }
