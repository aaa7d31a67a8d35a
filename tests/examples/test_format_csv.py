"""The example of a format is built, installed, and keeps its own tests."""

from pathlib import Path

from tests.examples.installing import installed, run_its_tests

EXAMPLE = Path(__file__).parents[2] / "examples" / "format_csv"


def test_its_tests_pass_where_it_is_installed(tmp_path: Path) -> None:
    assert "3 passed" in run_its_tests(EXAMPLE, installed(EXAMPLE, tmp_path), tmp_path)
