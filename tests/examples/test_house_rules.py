"""The example of a lab's own checks is built, installed, and keeps its own tests."""

from pathlib import Path

from tests.examples.installing import installed, run_its_tests

EXAMPLE = Path(__file__).parents[2] / "examples" / "house_rules"


def test_its_tests_pass_where_it_is_installed(tmp_path: Path) -> None:
    assert "2 passed" in run_its_tests(EXAMPLE, installed(EXAMPLE, tmp_path), tmp_path)
