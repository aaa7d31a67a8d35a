"""Drivers by name."""

import subprocess
import sys
from importlib.metadata import EntryPoint
from typing import Any

import pytest
from pydantic import BaseModel

from exumi_data.errors import UsageError
from exumi_recorders.contract import DriverType
from exumi_recorders.drivers import registry


class Options(BaseModel):
    pass


def make(options: Options) -> Any:
    raise AssertionError(options)


GLOVE = DriverType("glove", "A glove.", Options, make)


def test_an_unknown_driver_is_named_beside_those_that_are_there() -> None:
    with pytest.raises(UsageError, match="no driver 'quost'"):
        registry.find_driver("quost")


def test_drivers_are_loaded_when_they_are_named_and_what_they_need_when_they_are_opened() -> None:
    code = """
import sys
from exumi_recorders.drivers import registry
before = {name for name in sys.modules if name.startswith("exumi_recorders.drivers.")}
for name in registry.driver_names():
    registry.find_driver(name)
print(*before, *{"av", "cv2", "scipy", "serial", "smbus2", "yaml"} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["exumi_recorders.drivers.registry"]


def test_another_package_adds_a_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("glove", "exumi_fake_glove:GLOVE", registry.DRIVERS)
    monkeypatch.setattr(EntryPoint, "load", lambda _: GLOVE)
    monkeypatch.setattr("exumi_data.plugins.entry_points", lambda **_: [point])
    assert "glove" in registry.driver_names()
    assert registry.find_driver("glove") is GLOVE


def test_what_is_no_driver_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("mitten", "exumi_fake_glove:GLOVE", registry.DRIVERS)
    monkeypatch.setattr(EntryPoint, "load", lambda _: GLOVE)
    monkeypatch.setattr("exumi_data.plugins.entry_points", lambda **_: [point])
    with pytest.raises(UsageError, match="no DriverType of that name"):
        registry.find_driver("mitten")
