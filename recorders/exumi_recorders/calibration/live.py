"""Readings straight from a rig's devices, with the operator beside them; nothing is recorded."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.errors import ExumiError, UsageError
from exumi_data.gripper_readings import GripperReadings, circular_mean, from_mean
from exumi_data.standard import flags
from exumi_data.store import jpeg
from exumi_recorders.calibration.files import Calibration, merge
from exumi_recorders.calibration.tactile import captured_reference
from exumi_recorders.contract import Driver, Files, Port, Rows, Sample
from exumi_recorders.finalise.rows import row_dtype
from exumi_recorders.rig.loading import load_rig
from exumi_recorders.rig.model import Rig, expanded
from exumi_recorders.rig.simulated import NAME, SimulatedSettings, simulated_rig

__all__ = [
    "BACK",
    "LivePort",
    "OpeningReading",
    "capture_references",
    "encoder_of",
    "live_rig",
    "ports_of",
    "read_opening",
    "read_openings",
    "tactile_of",
]

Ask = Callable[[str], str]
Tell = Callable[[str], None]

BACK = "b"
"""What the operator answers to read the opening before once more."""

_READ_S = 0.05
_FEWEST = 20
# Counts: a gripper that is held still keeps within the encoder's noise.
_MOST_RANGE = 6
# Cameras begin with frames whose exposure is not settled, or that are old.
_SETTLE_S = 1.0
_SIMULATED_S = 4.0


@dataclass(frozen=True, slots=True)
class LivePort:
    """A port of a rig's device that can be read.

    Attributes
    ----------
    device : str
    driver : Driver
        Not open.
    port : Port
    stream : str
        What its stream is called.
    """

    device: str
    driver: Driver
    port: Port
    stream: str

    @contextmanager
    def opened(self) -> "Iterator[LivePort]":
        """Open the device, and close it after the block.

        Yields
        ------
        LivePort
            With the port as the open device has it.
        """
        try:
            self.driver.open()
            ports = {port.name: port for port in self.driver.ports}
            if self.port.name not in ports:
                raise UsageError(f"the device has no port {self.port.name!r}", where=self.device)
            yield LivePort(self.device, self.driver, ports[self.port.name], self.stream)
        finally:
            self.driver.close()

    def samples(self, seconds: float) -> list[Sample]:
        """Return what the open device delivers from now on.

        Parameters
        ----------
        seconds : float
        """
        start_ns = time.monotonic_ns()
        stop_ns = start_ns + round(seconds * 1e9)
        found: list[Sample] = []
        while time.monotonic_ns() < stop_ns:
            for item in self.driver.read(_READ_S):
                if not isinstance(item, Sample) or item.port != self.port.name:
                    continue
                if start_ns <= item.time_host_ns < stop_ns:
                    found.append(item)
        return found


@contextmanager
def live_rig(name: str) -> Iterator[Rig]:
    """Read a rig file, whose calibration need not be there yet; or start the simulated rig.

    Parameters
    ----------
    name : str
        Path of the rig file, or ``simulated``.
    """
    if name != NAME:
        yield load_rig(expanded(name))
        return
    with simulated_rig(SimulatedSettings(seconds=_SIMULATED_S)) as started:
        # When the session is over, the hand rests and touches nothing.
        over_s = 1e-9 * (started.epoch_ns - time.monotonic_ns()) + _SIMULATED_S
        time.sleep(max(0.0, over_s))
        yield started.rig


def ports_of(rig: Rig, wanted: Callable[[Port], bool]) -> list[LivePort]:
    """Return those ports of a rig's devices that are recorded, and wanted; none is open.

    Parameters
    ----------
    rig : Rig
    wanted : callable
    """
    found = []
    for device in rig.devices:
        driver = device.driver.make(device.options)
        found += [
            LivePort(device.name, driver, port, device.streams[port.name])
            for port in driver.ports
            if port.name in device.streams and wanted(port)
        ]
    return found


def encoder_of(rig: Rig, device: str | None) -> LivePort:
    """Return the encoder of a rig's gripper.

    Parameters
    ----------
    rig : Rig
    device : str or None
        Which device, where there are several.

    Raises
    ------
    UsageError
        There is none, or more than one.
    """
    found = [
        port
        for port in ports_of(rig, lambda port: port.transform == "encoder_map")
        if device in (None, port.device)
    ]
    if len(found) != 1:
        named = ", ".join(port.device for port in found) or "none"
        raise UsageError(
            f"which encoder: {named}", where=rig.path, fix="Name its device with --device."
        )
    return found[0]


def tactile_of(rig: Rig, stream: str | None) -> list[LivePort]:
    """Return the tactile cameras of a rig.

    Parameters
    ----------
    rig : Rig
    stream : str or None
        Only this one.

    Raises
    ------
    UsageError
        There is none.
    """
    found = [
        port
        for port in ports_of(
            rig, lambda port: port.kind == "tactile" and isinstance(port.payload, Files)
        )
        if stream in (None, port.stream)
    ]
    if not found:
        raise UsageError(
            f"no tactile camera{f' {stream!r}' if stream else ''}",
            where=rig.path,
            fix=f"Streams of the rig: {', '.join(rig.stream_names)}.",
        )
    return found


@dataclass(frozen=True, slots=True, eq=False)
class OpeningReading:
    """What an encoder said at one opening.

    Attributes
    ----------
    opening_m : float
    counts : (N,) int64
    mean, spread : float
        Mean and standard deviation on the circle, counts.
    problem : str
        Why it is no reading; empty where it is one.
    """

    opening_m: float
    counts: NDArray[np.int64]
    mean: float
    spread: float
    problem: str


def read_opening(encoder: LivePort, opening_m: float, *, seconds: float = 1.0) -> OpeningReading:
    """Read an encoder for a while at a known opening.

    Parameters
    ----------
    encoder : LivePort
        Open.
    opening_m : float
    seconds : float, optional

    Returns
    -------
    OpeningReading
        An unsteady one has a `problem`.

    Raises
    ------
    DeviceLostError
        The device is gone.
    """
    samples = encoder.samples(seconds)
    invalid = flags()["invalid"].mask
    good = [sample.payload for sample in samples if not sample.flags & invalid]
    assert isinstance(encoder.port.payload, Rows)  # noqa: S101  # an encoder's samples are rows
    rows = np.frombuffer(b"".join(good), row_dtype(encoder.port.payload))
    counts = rows["raw"].astype(np.int64)
    if len(counts) < _FEWEST:
        problems = encoder.driver.health().problems
        reason = problems[0] if problems else f"{len(counts)} usable readings of {len(samples)}"
        return OpeningReading(opening_m, counts, np.nan, np.nan, reason)
    modulus = modulus_of(encoder.port)
    mean, spread = circular_mean(counts, modulus)
    away = from_mean(counts, mean, modulus)
    moved = float(away.max() - away.min())
    problem = "" if moved <= _MOST_RANGE else f"it moved by {moved:.0f} counts: hold it still"
    return OpeningReading(opening_m, counts, mean, spread, problem)


def modulus_of(port: Port) -> int | None:
    """Return where a port's counts wrap; None where turns are counted."""
    modulus: int | None = (port.metadata.get("raw") or {}).get("modulus")
    return modulus


def read_openings(
    encoder: LivePort,
    openings_m: Sequence[float],
    ask: Ask,
    tell: Tell,
    *,
    seconds: float = 1.0,
) -> GripperReadings:
    """Go through openings with the operator, one by one; an unsteady reading is taken again.

    Parameters
    ----------
    encoder : LivePort
        Open.
    openings_m : sequence of float
        In the order in which they are set.
    ask : callable
        Tells the operator what to do, and returns what was answered when it is done: `BACK` takes
        the opening before once more.
    tell : callable
        Shows what was read.
    seconds : float, optional
        For each opening.

    Returns
    -------
    GripperReadings
    """
    taken: list[OpeningReading] = []
    while len(taken) < len(openings_m):
        opening_m = openings_m[len(taken)]
        back = f" ({BACK}: the one before again)" if taken else ""
        if ask(f"set the gripper to {1e3 * opening_m:g} mm, then Enter{back}: ") == BACK:
            taken = taken[:-1]
            continue
        found = read_opening(encoder, opening_m, seconds=seconds)
        problem = found.problem or _unmoved(taken[-1:], found, modulus_of(encoder.port))
        if problem:
            tell(f"  not taken: {problem}")
            continue
        tell(f"  count {found.mean:.1f} ± {found.spread:.1f}, {len(found.counts)} readings")
        taken.append(found)
    return GripperReadings(
        tuple(reading.opening_m for reading in taken),
        tuple(reading.counts for reading in taken),
        modulus_of(encoder.port),
        ("read live",),
    )


def _unmoved(before: Sequence[OpeningReading], found: OpeningReading, modulus: int | None) -> str:
    """Say so where the count is still that of the opening before, if there is one.

    At the end all readings would be in vain.
    """
    for other in before:
        away = float(from_mean(np.array([found.mean]), other.mean, modulus)[0])
        if other.opening_m != found.opening_m and abs(away) <= _MOST_RANGE:
            return (
                f"the count is that of {1e3 * other.opening_m:g} mm still, {found.mean:.0f}: "
                "does the encoder turn with the gripper?"
            )
    return ""


def capture_references(ports: Sequence[LivePort], *, seconds: float = 1.0) -> Calibration:
    """Take the references of tactile cameras, one after the other. Nothing may touch the fingers.

    Parameters
    ----------
    ports : sequence of LivePort
        Not open.
    seconds : float, optional

    Returns
    -------
    Calibration
        An item ``tactile_reference/<stream>`` with its array for each.

    Raises
    ------
    CalibrationRefusedError
        Too few frames, or something changes.
    DeviceError
        A camera cannot be opened, or is lost.
    """
    found = {}
    for port in ports:
        with port.opened() as live:
            live.samples(_SETTLE_S)
            samples = live.samples(seconds)
            found[port.stream] = captured_reference(_decoded(live.port, samples), port.stream)
    return merge(found)


def _decoded(port: Port, samples: Sequence[Sample]) -> Iterator[NDArray[np.uint8]]:
    payload = port.payload
    assert isinstance(payload, Files)  # noqa: S101  # others are not among the tactile cameras
    for sample in samples:
        frame = np.empty((payload.height, payload.width, payload.channels), np.uint8)
        try:
            jpeg.decode_into(sample.payload, frame)
        except ExumiError:
            continue  # a damaged frame: there are others
        yield frame
