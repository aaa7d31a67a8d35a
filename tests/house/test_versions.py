"""One version, wherever it is written."""

import importlib.metadata
import re
from pathlib import Path

import exumi_data


def first(pattern: str, path: Path) -> str:
    match = re.search(pattern, path.read_text("utf-8"), re.MULTILINE)
    assert match, f"{path.name} has nothing like {pattern}"
    return match[1]


def test_the_installed_metadata_agrees() -> None:
    assert importlib.metadata.version("exumi-data") == exumi_data.__version__


def test_the_citation_agrees(root: Path) -> None:
    assert first(r"^version: (.+)$", root / "CITATION.cff") == exumi_data.__version__


def test_the_newest_entry_of_the_changelog_agrees(root: Path) -> None:
    assert first(r"^## \[(.+?)\]", root / "CHANGELOG.md") == exumi_data.__version__
