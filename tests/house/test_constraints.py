"""The pins are complete, fit what pyproject.toml asks for, and hold on any machine."""

import re
import runpy
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

PIN = re.compile(r"(?P<name>[a-z0-9][a-z0-9.-]*)==(?P<version>[0-9][0-9a-z.]*)")


@pytest.fixture(scope="module")
def pins(root: Path) -> dict[str, str]:
    """Name and version of each line; any other kind of line is a mistake."""
    lines = (root / "constraints.txt").read_text("utf-8").splitlines()
    found = {}
    for line in lines:
        if line.startswith("#"):
            continue
        match = PIN.fullmatch(line)
        assert match, f"{line!r} is not name==version"
        found[match["name"]] = match["version"]
    return found


@pytest.fixture(scope="module")
def project(root: Path) -> dict[str, list[str]]:
    """The dependencies, by extra; those of the core under ``core``."""
    table = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    return {"core": table["dependencies"], **table["optional-dependencies"]}


@pytest.mark.parametrize("extra", ["core", "train", "test"])
def test_what_make_setup_installs_is_pinned(
    extra: str, project: dict[str, list[str]], pins: dict[str, str]
) -> None:
    for line in project[extra]:
        requirement = Requirement(line)
        assert requirement.specifier.contains(pins[requirement.name]), line


def test_torch_is_an_extra_pinned_without_a_build(
    project: dict[str, list[str]], pins: dict[str, str]
) -> None:
    assert pins["torch"] == "2.13.0"
    holders = {
        extra
        for extra, lines in project.items()
        for line in lines
        if Requirement(line).name == "torch"
    }
    assert holders == {"train"}


def test_freezing_leaves_out_what_holds_on_one_machine_only(root: Path) -> None:
    freeze = runpy.run_path(str(root / "scripts" / "freeze.py"))["constraints"]
    text = "torch==2.13.0+cpu\nPyYAML==6.0\nnvidia-cublas==13.1\npip==26.0\nzarr==3.1.6\n"
    assert freeze(text) == ["pyyaml==6.0", "torch==2.13.0", "zarr==3.1.6"]
    with pytest.raises(ValueError, match="package index"):
        freeze(f"torch @ file://{sys.prefix}/torch.whl\n")
