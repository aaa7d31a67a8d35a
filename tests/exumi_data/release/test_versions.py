import pytest

from exumi_data.errors import UsageError
from exumi_data.release.versions import Step, decide_version, next_version, step_between


@pytest.mark.parametrize(
    ("step", "version"), [("patch", "1.4.10"), ("minor", "1.5.0"), ("major", "2.0.0")]
)
def test_next_version(step: Step, version: str) -> None:
    assert next_version("1.4.9", step) == version
    assert step_between("1.4.9", version) == step
    assert decide_version("auto", "1.4.9", step) == version
    assert decide_version(version, "1.4.9", step) == version


def test_first_version() -> None:
    assert decide_version("auto", None, None) == "1.0.0"
    assert decide_version("0.3.1", None, None) == "0.3.1"


def test_more_than_is_called_for() -> None:
    assert decide_version("3.0.0", "1.0.0", "patch") == "3.0.0"


@pytest.mark.parametrize(
    ("wanted", "needed", "said"),
    [
        ("1.0.1", "minor", "minor"),
        ("1.9.0", "major", "major"),
        ("1.0.0", None, "not later"),
        ("0.9.9", "patch", "not later"),
        ("1.0", None, "no version"),
        ("01.0.0", None, "no version"),
        ("1.0.0-rc1", None, "no version"),
    ],
)
def test_wrong_versions(wanted: str, needed: Step | None, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        decide_version(wanted, "1.0.0", needed)
