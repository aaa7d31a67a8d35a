"""Where a session records to: what cannot be a dataset is refused before a device is opened."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from exumi_data.errors import UsageError
from exumi_recorders.session.operator import Operator
from exumi_recorders.session.plan import Plan
from exumi_recorders.session.running import open_session
from exumi_recorders.session.session import Session

RIG = """
format = "exumi-rig"
version = "1.0"

[rig]
name = "toy"
licence = "CC0-1.0"

[devices.encoder]
driver = "as5600"
simulated = { epoch_ns = 0 }
streams = { width = "width" }
"""


@contextmanager
def opened(folder: Path, out: Path, plan: Plan | None = None) -> Iterator[Session]:
    (folder / "rig.toml").write_text(RIG)
    plan = plan or Plan(task="toy", uncalibrated=True)
    with open_session(str(folder / "rig.toml"), out, plan, Operator(quiet=True)) as session:
        yield session


def refused(folder: Path, out: Path, plan: Plan | None = None) -> str:
    with pytest.raises(UsageError) as caught, opened(folder, out, plan):
        pass
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "called"), [("a\nb", "a b"), ("-dash", "-dash"), ("\udcff", "recordings")]
)
def test_folders_of_odd_names(tmp_path: Path, name: str, called: str) -> None:
    with opened(tmp_path, tmp_path / name):
        pass
    assert json.loads((tmp_path / name / "dataset.json").read_text())["name"] == called


def test_a_dataset_in_another_one(tmp_path: Path) -> None:
    with opened(tmp_path, tmp_path / "set"):
        pass
    for inner in ("sub", ".recording", "episodes/new"):
        text = refused(tmp_path, tmp_path / "set" / inner)
        assert f"lies in the dataset {tmp_path / 'set'}" in text
        assert not (tmp_path / "set" / inner / "dataset.json").exists()
    with opened(tmp_path, tmp_path / "set"):
        pass


def test_links_that_lead_nowhere(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "gone").symlink_to(tmp_path / "none")
    for name in ("loop", "gone"):
        assert "leads nowhere" in refused(tmp_path, tmp_path / name)


def test_a_plan_that_no_episode_can_hold(tmp_path: Path) -> None:
    assert "--task has to be one line" in refused(tmp_path, tmp_path / "set", Plan(task="a\nb"))
    assert not (tmp_path / "set").exists()
