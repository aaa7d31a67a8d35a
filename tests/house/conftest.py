"""The project's own files, as the tests of the house see them."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    "exumi_data": ROOT / "exumi_data",
    "exumi_converters": ROOT / "converters" / "exumi_converters",
    "exumi_validators": ROOT / "validators" / "exumi_validators",
    "exumi_loaders": ROOT / "loaders" / "exumi_loaders",
    "exumi_recorders": ROOT / "recorders" / "exumi_recorders",
}


@pytest.fixture(scope="session")
def root() -> Path:
    """The top folder of the checkout."""
    return ROOT


@pytest.fixture(params=PACKAGES)
def package(request: pytest.FixtureRequest) -> Path:
    """The folder of each of the five packages in turn."""
    return PACKAGES[request.param]


@pytest.fixture(scope="session")
def modules() -> dict[str, Path]:
    """Every module of the five packages: its dotted name and its file."""
    found = {}
    for folder in PACKAGES.values():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder.parent).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = path
    return found
