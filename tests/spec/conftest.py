"""The standard's own files."""

from pathlib import Path

import pytest

SPEC = Path(__file__).resolve().parents[2] / "spec"


@pytest.fixture(scope="session")
def spec() -> Path:
    """The folder of the standard."""
    return SPEC


@pytest.fixture(scope="session")
def corpus() -> Path:
    """The conformance corpus of 1.0."""
    return SPEC / "conformance" / "1.0"
