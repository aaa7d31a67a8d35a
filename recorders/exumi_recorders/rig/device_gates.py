"""Gates of devices and their streams: open, healthy, fast enough, without losses."""

from collections.abc import Iterable, Mapping, Sequence

from exumi_data.errors import ExumiError
from exumi_data.time import parse_rate
from exumi_recorders.rig.gate import Gate, Verdict
from exumi_recorders.rig.model import Rig
from exumi_recorders.rig.probing import ProbedDevice, ProbedStream

__all__ = ["device_gates", "flag_gate", "rate_gate", "world_frame_gates"]

# Lost samples are counted and marked, so a few only need a look.
_MOST_LOST = 0.05


def device_gates(probed: ProbedDevice, *, seconds: float, least_rate: float) -> list[Gate]:
    """Judge a device and its streams.

    Parameters
    ----------
    probed : ProbedDevice
    seconds : float
        How long it was watched.
    least_rate : float
        Least share of a stream's nominal rate.
    """
    failure = probed.failure
    if failure is not None:
        what, fix = _said(failure)
        return [Gate("device", probed.name, "fail", what, "open", fix)]
    gates = [Gate("device", probed.name, "pass", "open", "open"), _health(probed)]
    gates += [
        rate_gate(stream, probed.health.problems, seconds=seconds, least_rate=least_rate)
        for stream in probed.streams.values()
    ]
    return [*gates, _drops(probed)]


def _said(failure: Exception) -> tuple[str, str]:
    if isinstance(failure, ExumiError):
        where = f"{failure.where}: " if failure.where else ""
        return f"{where}{failure.what}", failure.fix or "See docs/troubleshooting.md."
    text = str(failure) or type(failure).__name__
    return text, "Check its plug and its part of the rig file."


def _health(probed: ProbedDevice) -> Gate:
    """Judge what a device says of itself; an encoder says it of its magnet."""
    readings, problems = probed.health.readings, probed.health.problems
    name, found = "health", "well"
    verdict: Verdict = "warn" if problems else "pass"
    if "magnet" in readings:
        name = "magnet"
        found = f"seen, gain {readings.get('agc')}, magnitude {readings.get('magnitude')}"
        if not readings["magnet"]:
            verdict, found = "fail", "no magnet is seen"
    elif problems:
        found = f"{len(problems)} problems" if len(problems) > 1 else "a problem"
    expected = "a magnet at the right distance" if name == "magnet" else "no problem"
    return Gate(name, probed.name, verdict, found, expected, " ".join(problems))


def rate_gate(
    stream: ProbedStream, problems: Sequence[str], *, seconds: float, least_rate: float
) -> Gate:
    """Judge how many samples came.

    Parameters
    ----------
    stream : ProbedStream
    problems : sequence of str
        What the device says of itself.
    seconds : float
    least_rate : float
    """
    found_hz = stream.count / seconds
    found = f"{found_hz:.1f} Hz"
    stated = stream.port.nominal_rate
    if not stream.count:
        fix = " ".join(problems) or "Check that the device sends."
        return Gate("rate", stream.name, "fail", "no sample", "samples", fix)
    if stated is None:
        return Gate("rate", stream.name, "pass", found, "samples; no rate is stated")
    nominal_hz = float(parse_rate(stated))
    expected = f"{least_rate * nominal_hz:.4g} Hz, {least_rate:.0%} of {nominal_hz:g}"
    # Of slow streams, one sample more or less falls into the time by chance.
    if (stream.count + 1) / seconds >= least_rate * nominal_hz:
        return Gate("rate", stream.name, "pass", found, expected)
    fix = (
        "Plug it into a USB controller of its own, give cameras light for a shorter exposure, end "
        "other programs. Where it can do no more, lower `least_rate` in [limits]: times are "
        "measured, not taken from the rate."
    )
    return Gate("rate", stream.name, "fail", found, expected, fix)


def _drops(probed: ProbedDevice) -> Gate:
    came = sum(stream.count for stream in probed.streams.values())
    lost = sum(probed.lost.values())
    expected = "nothing lost"
    if not lost:
        return Gate("drops", probed.name, "pass", expected, expected)
    causes = ", ".join(f"{number} {cause}" for cause, number in sorted(probed.lost.items()))
    found = f"{causes}; {came:,} samples came"
    verdict: Verdict = "fail" if lost > _MOST_LOST * (came + lost) else "warn"
    fix = _fix_of(probed.lost)
    return Gate("drops", probed.name, verdict, found, expected, fix)


_FIXES: Mapping[str, str] = {
    "kernel": "The machine did not keep up: end other programs.",
    "late": "The machine did not keep up: end other programs, or ask for a lower `rate_hz`.",
    "sequence": "Frames are lost before they reach this program: a USB controller of its own, a "
    "shorter cable; a headset: another Wi-Fi channel.",
    "error": "The kernel calls frames damaged: another cable, another plug.",
    "bus": "Check the plug and the wires of the I2C bus.",
    "framing": "Check the plug, and that nothing else reads the device.",
    "overrun": "The machine did not keep up: end other programs.",
    "rejected_decimal_comma": "Set the headset's language to English.",
}


def _fix_of(lost: Iterable[str]) -> str:
    causes = {cause.rpartition("/")[2] for cause in lost}
    fixes = [text for cause, text in _FIXES.items() if cause in causes]
    return " ".join(dict.fromkeys(fixes)) or "See docs/troubleshooting.md."


def world_frame_gates(rig: Rig, probed: Sequence[ProbedDevice]) -> list[Gate]:
    """Judge whether the world is known that poses are given in.

    Parameters
    ----------
    rig : Rig
    probed : sequence of ProbedDevice
    """
    gates = []
    expected = "received"
    for device in probed:
        needed = device.name == rig.controls.world_frame
        moved = any(s.port.transform == "world_frame" for s in device.streams.values())
        if device.failure is not None or not (needed or moved):
            if needed:
                found = "the device is not open"
                gates.append(Gate("world_frame", device.name, "skipped", found, expected))
            continue
        if "world_frame" in device.events or device.health.readings.get("world_frame") is True:
            gates.append(Gate("world_frame", device.name, "pass", expected, expected))
            continue
        verdict: Verdict = "fail" if needed else "warn"
        fix = (
            "Mark the world in the app. The exUMI and ARCap apps send it once only: mark it while "
            "this program listens (--seconds 20), and again when the recorder does."
        )
        gates.append(Gate("world_frame", device.name, verdict, "not received", expected, fix))
    return gates


def flag_gate(rig: Rig, probed: Sequence[ProbedDevice]) -> Gate:
    """Judge what is to start and stop episodes.

    Parameters
    ----------
    rig : Rig
    probed : sequence of ProbedDevice
    """
    name = rig.controls.flag
    expected = "a device with a record flag, which is off"
    if name is None:
        found = "none is named: keys start and stop"
        return Gate("flag", "", "skipped", found, expected)
    device = next(one for one in probed if one.name == name)
    if device.failure is not None:
        return Gate("flag", name, "skipped", "the device is not open", expected)
    flag = device.health.readings.get("record_flag")
    if flag is None:
        fix = "Name the headset as `flag` in [controls], or leave it out and use the keys."
        return Gate("flag", name, "fail", "the device has no record flag", expected, fix)
    if flag:
        fix = "Press the button once, so that the next press begins an episode."
        return Gate("flag", name, "warn", "on", expected, fix)
    return Gate("flag", name, "pass", "off", expected)
