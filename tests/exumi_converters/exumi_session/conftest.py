"""Simulated sessions in the hub's own layout; tests that spoil one get a copy."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from exumi_converters import ConversionReport, ConvertOptions, convert
from exumi_data.dataset import Dataset, open_dataset
from exumi_data.simulation.hub_session import HubSession, HubSettings, simulate_hub_session

Converted = tuple[ConversionReport, Dataset]
Convert = Callable[..., Converted]


def run(source: Path, to: Path, **settings: str) -> Converted:
    options = ConvertOptions(workers=1, durable=False, settings=settings)
    report = convert(source, to, from_format="exumi-session", options=options)
    return report, open_dataset(to)


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> HubSession:
    """Two demonstrations and a latency clip with a sweep and moving fingers. Not to be changed."""
    folder = tmp_path_factory.mktemp("whole") / "batch_1"
    return simulate_hub_session(folder, HubSettings(seconds=5.0, sweep_s=7.0), demonstrations=2)


@pytest.fixture(scope="session")
def converted(whole: HubSession, tmp_path_factory: pytest.TempPathFactory) -> Converted:
    """What it becomes."""
    return run(whole.root, tmp_path_factory.mktemp("out") / "out")


@pytest.fixture(scope="session")
def small_original(tmp_path_factory: pytest.TempPathFactory) -> HubSession:
    settings = HubSettings(seconds=5.0, sweep_s=0.0, tactile_size=(120, 160), seed=3, late=0.03)
    return simulate_hub_session(tmp_path_factory.mktemp("small") / "s", settings, demonstrations=3)


@pytest.fixture(scope="session")
def small_converted(
    small_original: HubSession, tmp_path_factory: pytest.TempPathFactory
) -> Converted:
    """What three demonstrations without a latency clip become. Not to be changed."""
    return run(small_original.root, tmp_path_factory.mktemp("small-out") / "out")


@pytest.fixture
def small(small_original: HubSession, tmp_path: Path) -> HubSession:
    """Three demonstrations without a latency clip, to be spoilt."""
    root = tmp_path / "session"
    shutil.copytree(small_original.root, root)
    return replace(small_original, root=root, hub=root / small_original.hub.name)
