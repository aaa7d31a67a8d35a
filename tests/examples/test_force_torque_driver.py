"""The example of a driver is built, installed, and keeps its own tests."""

from pathlib import Path

from tests.examples.installing import installed, run_its_tests

EXAMPLE = Path(__file__).parents[2] / "examples" / "force_torque_driver"


def test_it_is_short() -> None:
    lines = (EXAMPLE / "acme_force_torque.py").read_text(encoding="utf-8").splitlines()
    assert len(lines) < 60


def test_its_tests_pass_where_it_is_installed(tmp_path: Path) -> None:
    assert "3 passed" in run_its_tests(EXAMPLE, installed(EXAMPLE, tmp_path), tmp_path)
