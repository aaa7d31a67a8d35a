"""Calibrations that read a rig's devices: an encoder on a simulated bus, simulated cameras."""

import io
import json
import sys
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.cli.app import app
from exumi_data.errors import UsageError
from exumi_data.gripper_readings import fit_gripper
from exumi_recorders.calibration import live
from exumi_recorders.calibration.files import read_calibration
from exumi_recorders.calibration.live import (
    BACK,
    LivePort,
    encoder_of,
    read_opening,
    read_openings,
    tactile_of,
)
from exumi_recorders.drivers import as5600
from exumi_recorders.drivers.as5600 import As5600, As5600Options
from exumi_recorders.rig.loading import load_rig
from exumi_recorders.simulated.as5600_chip import As5600Chip
from exumi_recorders.simulated.bus import SimulatedBus

RIG = """
format = "exumi-rig"
version = "1.0"

[rig]
name = "exumi"
licence = "CC-BY-4.0"
calibration = ["not-there-yet.json"]

[devices.encoder]
driver = "as5600"
streams = { width = "width" }
"""
OPENINGS_MM = (0, 10, 20, 30, 40)


class Gripper:
    """A gripper that somebody sets, with an encoder whose counts run over their end."""

    def __init__(self) -> None:
        self.opening_m = 0.0
        self.trembles = 0.0
        self.bus = SimulatedBus(As5600Chip(self._counts, 2.0))

    def _counts(self, now_ns: int) -> float:
        # Faster than it is looked at: at its turn a slow one would seem to rest.
        wave = self.trembles * np.sin(2 * np.pi * 15.0 * now_ns * 1e-9)
        return 3950.0 + 6200.0 * self.opening_m + float(wave)


@pytest.fixture
def gripper() -> Gripper:
    return Gripper()


@pytest.fixture
def encoder(gripper: Gripper) -> Iterator[LivePort]:
    driver = As5600(As5600Options(), lambda: gripper.bus)
    with LivePort("encoder", driver, driver.ports[0], "width").opened() as opened:
        yield opened


def read(encoder: LivePort, ask: Callable[[str], str], said: list[str]) -> Any:
    openings = [1e-3 * mm for mm in OPENINGS_MM]
    return read_openings(encoder, openings, ask, said.append, seconds=0.1)


def wanted_m(prompt: str) -> float:
    return 1e-3 * float(prompt.split()[4])


def test_openings_are_read_one_by_one(gripper: Gripper, encoder: LivePort) -> None:
    asked: list[str] = []

    def ask(prompt: str) -> str:
        asked.append(prompt)
        gripper.opening_m = wanted_m(prompt)
        # The third trembles, and is taken again; a busy machine may ask again for others.
        first = [round(1e3 * wanted_m(each)) for each in asked].count(20) == 1
        gripper.trembles = 30.0 if first and wanted_m(prompt) == 0.02 else 0.0
        return ""

    said: list[str] = []
    found = read(encoder, ask, said)
    wanted = [round(1e3 * wanted_m(prompt)) for prompt in asked]
    assert tuple(dict.fromkeys(wanted)) == OPENINGS_MM
    assert wanted.count(20) > 1
    assert any("not taken: it moved by" in text for text in said)
    assert any("count 3950" in text for text in said)
    fitted = fit_gripper(found)
    assert fitted.knots[:, 1] == pytest.approx((3950 + 62 * np.arange(5)) % 4096, abs=1.0)
    assert "the counts run over 4095 to 0 within the range" in fitted.notes


def test_a_reading_is_repeated(gripper: Gripper, encoder: LivePort) -> None:
    asked: list[int] = []

    def ask(prompt: str) -> str:
        asked.append(round(1e3 * wanted_m(prompt)))
        # 10 mm are set wrongly, which is noticed when 20 mm are asked for.
        gripper.opening_m = wanted_m(prompt) if 20 in asked or asked[-1] == 0 else 0.05
        return BACK if asked[-1] == 20 and asked.count(20) == 1 else ""

    counts = read(encoder, ask, []).counts
    # A busy machine may ask again for the same.
    assert [one for one, _ in groupby(asked)] == [0, 10, 20, 10, 20, 30, 40]
    assert np.mean(counts[1]) == pytest.approx(3950 + 62, abs=1.0)


def test_what_is_no_reading(gripper: Gripper, encoder: LivePort) -> None:
    assert "usable readings of" in read_opening(encoder, 0.0, seconds=0.01).problem
    gripper.bus.chip.magnet_gap_mm = 9.0
    encoder.samples(0.4)  # the chip's status is read five times a second
    found = read_opening(encoder, 0.0, seconds=0.1)
    assert "sees no magnet" in found.problem


def command(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        app(["calibrate", *map(str, words)])
    return int(ended.value.code or 0)


class Hand:
    """A stdin: each line that is read from it sets the gripper to the next opening."""

    def __init__(self, gripper: Gripper, last: int, *, ends: type[BaseException] | None) -> None:
        self._gripper, self._last, self._ends = gripper, last, ends
        self._at = 0

    def isatty(self) -> bool:
        return False

    def readline(self) -> str:
        if self._at == self._last:
            if self._ends is not None:
                raise self._ends
            return ""
        self._gripper.opening_m = 1e-3 * OPENINGS_MM[self._at]
        self._at += 1
        return "\n"


@pytest.fixture
def rig(tmp_path: Path, gripper: Gripper, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(as5600, "_real_bus", lambda _: gripper.bus)
    monkeypatch.setattr(live, "_READ_S", 0.02)
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def test_the_command(
    rig: Path,
    gripper: Gripper,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = rig.parent / "gripper.json"
    openings = ("--openings-mm", ",".join(map(str, OPENINGS_MM)))
    arguments = ("gripper", "--rig", rig, *openings, "--out", out, "-f", "json")
    for ends, code in ((None, 2), (KeyboardInterrupt, 130)):
        monkeypatch.setattr(sys, "stdin", Hand(gripper, 1, ends=ends))
        assert command(*arguments) == code
        assert not gripper.bus.is_open
        assert sorted(path.name for path in rig.parent.iterdir()) == ["rig.toml"]
    assert "the input ended before all was read" in capsys.readouterr().err
    monkeypatch.setattr(sys, "stdin", Hand(gripper, len(OPENINGS_MM), ends=None))
    assert command(*arguments) == 0
    shown = capsys.readouterr()
    assert "set the gripper to 40 mm, then Enter" in shown.err
    readings = json.loads(shown.out)["readings"]
    assert [row["opening_mm"] for row in readings] == pytest.approx(OPENINGS_MM)
    item = read_calibration(out).items["width_map"]
    assert "read live" in (item.procedure or "")
    assert command("gripper", "--rig", rig, "--out", out) == 2
    assert command("gripper", "--out", out) == 2
    assert command("gripper", rig, "--rig", rig, "--out", out) == 2
    assert command("tactile", "--rig", rig, "--out", out) == 2
    assert "no tactile camera" in capsys.readouterr().err


def test_which_encoder(rig: Path) -> None:
    found = load_rig(rig)
    assert encoder_of(found, None).stream == encoder_of(found, "encoder").stream == "width"
    with pytest.raises(UsageError, match="which encoder: none"):
        encoder_of(found, "other")
    with pytest.raises(UsageError, match="no tactile camera 'gel'"):
        tactile_of(found, "gel")


def test_references_of_the_simulated_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
    monkeypatch.setattr(live, "_SETTLE_S", 0.2)
    out = tmp_path / "fingers.json"
    assert command("tactile", "--rig", "simulated", "--out", out) == 0
    found = read_calibration(out)
    names = ["tactile_reference/tactile_left", "tactile_reference/tactile_right"]
    assert sorted(found.items) == names
    assert found.arrays[names[0]].shape == (240, 320, 3)
    assert "nothing changes in" in (found.items[names[0]].procedure or "")
