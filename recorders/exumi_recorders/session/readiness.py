"""Whether a rig is calibrated well enough to record with: what can be known without waiting."""

from collections.abc import Sequence

from exumi_data.errors import UsageError
from exumi_recorders.rig.calibration_gates import calibration_gates
from exumi_recorders.rig.devices import recorded_devices, recorded_ports
from exumi_recorders.rig.gate import Gate
from exumi_recorders.rig.model import Rig
from exumi_recorders.session.plan import Calibrated

__all__ = ["check_calibration"]


def check_calibration(rig: Rig, calibrated: Calibrated, *, uncalibrated: bool) -> str | None:
    """Refuse to record what nobody could read; return what else the operator should know.

    Parameters
    ----------
    rig : Rig
    calibrated : Calibrated
    uncalibrated : bool
        Record all the same, such as to calibrate by it.

    Returns
    -------
    str or None
        A warning, if there is a reason.

    Raises
    ------
    UsageError
        An encoder has no map to widths, or an item is wrong.
    """
    gates = calibration_gates(recorded_ports(recorded_devices(rig)), calibrated.items)
    wrong = [gate for gate in gates if gate.verdict == "fail"]
    if wrong and not uncalibrated:
        raise UsageError(
            f"this rig is not calibrated: {_listed(wrong)}",
            where=rig.path,
            fix=" ".join(dict.fromkeys(gate.what_to_do for gate in wrong)),
        )
    doubtful = [gate for gate in gates if gate.verdict == "warn"]
    if not (wrong or doubtful):
        return None
    text = f"not calibrated: {_listed(wrong + doubtful)}"
    return f"{text}; exumi rig check says what to do, and exumi calibrate apply mends it later"


def _listed(gates: Sequence[Gate]) -> str:
    """Name streams by gate, such as ``latency of pose, rgb; width_map of width``."""
    names = dict.fromkeys(gate.name for gate in gates)
    parts = []
    for name in names:
        streams = ", ".join(gate.where for gate in gates if gate.name == name)
        parts.append(f"{name} of {streams}")
    return "; ".join(parts)
