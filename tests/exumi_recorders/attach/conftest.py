"""A simulated hub run that several tests look at; nobody changes it."""

from pathlib import Path

import pytest

from exumi_recorders.attach import AttachOptions, AttachReport, attach
from exumi_recorders.simulated.hub_run import HubRun, simulate_hub_run


@pytest.fixture(scope="session")
def hub_run(tmp_path_factory: pytest.TempPathFactory) -> HubRun:
    """Twelve demonstrations, one of them without a clip, and a clip of another run."""
    return simulate_hub_run(tmp_path_factory.mktemp("run"), demonstrations=12, seconds=6.0)


@pytest.fixture(scope="session")
def demos(hub_run: HubRun, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, AttachReport]:
    """The dataset that they become, and what was reported."""
    root = tmp_path_factory.mktemp("demos") / "demos"
    options = AttachOptions(durable=False)
    return root, attach(hub_run.clips, hub_run.session, root, options=options)
