"""``exumi rig check``: every gate of the preflight, all that is wrong at once."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from exumi_data.errors import ExumiError
from exumi_data.width_map import WIDTH_MAP
from exumi_recorders.contract import Port
from exumi_recorders.journal.space import SpaceLimits, free_bytes, seconds_left
from exumi_recorders.rig.calibration_gates import calibration_gates, width_gate
from exumi_recorders.rig.calibrations import read_calibrations
from exumi_recorders.rig.device_gates import device_gates, flag_gate, world_frame_gates
from exumi_recorders.rig.devices import recorded_devices, recorded_ports
from exumi_recorders.rig.finger_gates import finger_gates
from exumi_recorders.rig.gate import Gate
from exumi_recorders.rig.hub_clock import clock_gates, read_clock_state
from exumi_recorders.rig.model import Rig
from exumi_recorders.rig.probing import ProbedDevice, probe
from exumi_recorders.rig.touch_gates import touch_gates
from exumi_recorders.session.hooks import missing_program
from exumi_recorders.session.plan import Calibrated

__all__ = ["RigReport", "check_rig", "disk_gate", "hook_gates"]

_EASY = 5.0
_LONG = 600


@dataclass(frozen=True, slots=True)
class RigReport:
    """What a preflight found.

    Attributes
    ----------
    rig : str
        The rig file.
    gates : tuple of Gate
    """

    rig: str
    gates: tuple[Gate, ...]

    @property
    def passed(self) -> bool:
        """Whether no gate fails."""
        return all(gate.verdict != "fail" for gate in self.gates)

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "format": "exumi-rig-check",
            "version": "1.0",
            "rig": self.rig,
            "passed": self.passed,
            "gates": [gate.to_json() for gate in self.gates],
        }


def check_rig(
    rig: Rig,
    *,
    calibrated: Calibrated | None = None,
    out: Path | None = None,
    seconds: float = 3.0,
    ask: Callable[[str], str] | None = None,
) -> RigReport:
    """Open all devices of a rig, watch them for some seconds, and judge everything.

    Parameters
    ----------
    rig : Rig
    calibrated : Calibrated, optional
        Default: what the rig file names.
    out : pathlib.Path, optional
        The dataset to record to. Default: that of the rig file.
    seconds : float
    ask : callable, optional
        Tells the operator what to do, and returns when it is done: each finger is then pressed, to
        see that left and right are not exchanged.
    """
    calibrated, gates = _calibration_of(rig, calibrated)
    devices = recorded_devices(rig)
    ports = recorded_ports(devices)
    probed = probe(devices, seconds)
    for device in probed:
        gates += device_gates(device, seconds=seconds, least_rate=rig.limits.least_rate)
    gates += world_frame_gates(rig, probed)
    gates.append(flag_gate(rig, probed))
    streams = [stream for device in probed for stream in device.streams.values()]
    gates += finger_gates(streams, calibrated.arrays)
    if ask is not None:
        gates += touch_gates(rig, streams, ask)
    # Of a device that could not be opened, what its options say.
    ports |= {stream.name: stream.port for stream in streams}
    gates += _calibration_gates(ports, calibrated, probed)
    gates.append(disk_gate(rig, list(ports.values()), out))
    gates += clock_gates(datetime.now(UTC), read_clock_state(), calibrated.items.values())
    gates += hook_gates(rig)
    return RigReport("simulated" if rig.path is None else str(rig.path), tuple(gates))


def _calibration_of(rig: Rig, calibrated: Calibrated | None) -> tuple[Calibrated, list[Gate]]:
    """Read what the rig file names; a file that cannot be read is a failure like others."""
    expected = "readable calibration files"
    if calibrated is not None:
        return calibrated, []
    if not rig.about.calibration:
        found, fix = "none is named", "Name it as `calibration` in [rig]."
        return Calibrated(), [Gate("calibration", "", "warn", found, expected, fix)]
    try:
        read = read_calibrations(rig)
    except ExumiError as error:
        found = error.what if error.where is None else f"{error.where}: {error.what}"
        fix = error.fix or "Calibrate again, or restore the file."
        return Calibrated(), [Gate("calibration", "", "fail", found, expected, fix)]
    return read, [Gate("calibration", "", "pass", f"{len(read.items)} items", expected)]


def _calibration_gates(
    ports: Mapping[str, Port], calibrated: Calibrated, probed: Sequence[ProbedDevice]
) -> list[Gate]:
    """Judge the calibration; of a width, also what the encoder says now."""
    latest = {stream.name: stream.latest for device in probed for stream in device.streams.values()}
    return [
        width_gate(gate.where, ports[gate.where], calibrated.items, latest.get(gate.where))
        if gate.name == WIDTH_MAP
        else gate
        for gate in calibration_gates(ports, calibrated.items)
    ]


def disk_gate(rig: Rig, ports: Sequence[Port], out: Path | None = None) -> Gate:
    """Judge for how long there is room, and whether it can be written to.

    Parameters
    ----------
    rig : Rig
    ports : sequence of Port
    out : pathlib.Path, optional
        The dataset. Default: that of the rig file.
    """
    least = rig.limits.least_minutes
    expected = f"{least:g} minutes or more"
    if out is None and rig.about.data is not None:
        out = rig.beside(rig.about.data)
    if out is None:
        return Gate("disk", "", "skipped", "no dataset is named (--out)", expected)
    folder = next(place for place in (out.absolute(), *out.absolute().parents) if place.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        fix = "Name another folder, or allow yourself to write to this one."
        return Gate("disk", str(out), "fail", f"{folder} cannot be written to", expected, fix)
    limits = SpaceLimits(reserve_bytes=rig.limits.reserve_mb << 20)
    free = free_bytes(folder)
    fix = "Copy recordings away and remove them here, or record to another disk."
    if free < limits.soft_bytes:
        expected = f"{limits.soft_bytes / 1e9:.2f} GB or more"
        return Gate("disk", str(out), "fail", f"{free / 1e9:.2f} GB are free", expected, fix)
    minutes = seconds_left(folder, ports, limits) / 60
    found = f"{minutes:.0f} minutes" if minutes < _LONG else f"{minutes / 60:.0f} hours"
    if minutes < least:
        return Gate("disk", str(out), "fail", found, expected, fix)
    if minutes < _EASY * least:
        expected = f"{_EASY * least:g} minutes or more; {least:g} are a must"
        return Gate("disk", str(out), "warn", found, expected, fix)
    return Gate("disk", str(out), "pass", found, expected)


def hook_gates(rig: Rig) -> list[Gate]:
    """Judge whether the programs of the rig file's ``[hooks]`` are there.

    Parameters
    ----------
    rig : Rig
    """
    gates = []
    for name in type(rig.hooks).model_fields:
        command = getattr(rig.hooks, name)
        if command is None:
            continue
        missing = missing_program(command)
        if missing is None:
            gates.append(Gate("hook", name, "pass", command[0], "a program"))
        else:
            fix = f"Install {missing}, or correct `{name}` in [hooks]."
            gates.append(Gate("hook", name, "warn", f"no program {missing}", "a program", fix))
    return gates
