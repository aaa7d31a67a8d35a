"""Watching all devices of a rig for some seconds, without recording anything."""

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from exumi_recorders.contract import DeviceError, Event, Files, Health, Port, Sample
from exumi_recorders.recording.device import RecordedDevice

__all__ = ["ProbedDevice", "ProbedStream", "probe"]

_OPEN_S = 30.0
_SETTLE_S = 0.5
_GRACE_S = 0.2
_READ_S = 0.1
_FRAMES = 9


@dataclass(slots=True)
class ProbedStream:
    """What came of one stream.

    Attributes
    ----------
    name : str
    device : str
    port : Port
        As it is once the device is open.
    count : int
        Samples that were stamped while all devices were watched.
    latest : bytes or None
        Payload of the newest sample.
    frames : deque of bytes
        Of images: a few, spread over the time.
    """

    name: str
    device: str
    port: Port
    count: int = 0
    latest: bytes | None = None
    frames: deque[bytes] = field(default_factory=lambda: deque(maxlen=_FRAMES))
    _kept_ns: int | None = None

    def take(self, sample: Sample, every_ns: int) -> None:
        """Take a sample that was stamped while all devices were watched.

        Parameters
        ----------
        sample : Sample
        every_ns : int
            How far apart the frames that are kept are.
        """
        self.count += 1
        self.latest = sample.payload
        if isinstance(self.port.payload, Files) and (
            self._kept_ns is None or sample.time_host_ns - self._kept_ns >= every_ns
        ):
            self._kept_ns = sample.time_host_ns
            self.frames.append(sample.payload)


@dataclass(slots=True)
class ProbedDevice:
    """How one device did.

    Attributes
    ----------
    name : str
    failure : Exception or None
        Why it could not be opened, or was lost.
    streams : dict of str to ProbedStream
        By the streams' names; those of a device that could not be opened are missing.
    events : dict of str to Event
        The newest of each name, from the opening on.
    lost : dict of str to int
        By cause, while it was watched.
    health : Health
        At the end.
    """

    name: str
    failure: Exception | None = None
    streams: dict[str, ProbedStream] = field(default_factory=dict)
    events: dict[str, Event] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    health: Health = field(default_factory=Health)


@dataclass(slots=True)
class _Window:
    """When devices are watched: host times, and events for their threads."""

    every_ns: int
    start_ns: int | None = None
    end_ns: int | None = None
    over: threading.Event = field(default_factory=threading.Event)

    def holds(self, time_ns: int) -> bool:
        start_ns, end_ns = self.start_ns, self.end_ns
        return start_ns is not None and start_ns <= time_ns and (end_ns is None or time_ns < end_ns)


def probe(devices: Sequence[RecordedDevice], seconds: float) -> list[ProbedDevice]:
    """Open all devices, watch them together, and close them.

    Parameters
    ----------
    devices : sequence of RecordedDevice
        Not open.
    seconds : float
        How long to watch, from when the last one is open.

    Returns
    -------
    list of ProbedDevice
        In the same order; a device that fails stops none of the others.
    """
    window = _Window(every_ns=round(seconds / _FRAMES * 1e9))
    watched = [_Watched(device, window) for device in devices]
    for one in watched:
        one.thread.start()
    try:
        end_s = time.monotonic() + _OPEN_S
        for one in watched:
            one.wait_until_open(max(0.0, end_s - time.monotonic()))
        time.sleep(_SETTLE_S)
        before = [one.health() for one in watched]
        window.start_ns = time.monotonic_ns()
        time.sleep(seconds)
        window.end_ns = time.monotonic_ns()
        for one, then in zip(watched, before, strict=True):
            one.found.health = one.health()
            one.found.lost = _more(then.lost, one.found.health.lost)
        time.sleep(_GRACE_S)  # what was stamped before the end may still be on its way
    finally:
        window.over.set()
        for one in watched:
            one.thread.join(5.0)
    return [one.found for one in watched]


class _Watched:
    """A device and the thread that reads it."""

    def __init__(self, device: RecordedDevice, window: _Window) -> None:
        self.found = ProbedDevice(device.name)
        self._device = device
        self._window = window
        self._is_open = threading.Event()
        self.thread = threading.Thread(target=self._run, name=f"probe {device.name}", daemon=True)

    def wait_until_open(self, timeout_s: float) -> None:
        if not self._is_open.wait(timeout_s):
            self.found.failure = TimeoutError(f"it did not open within {_OPEN_S:g} s")

    def health(self) -> Health:
        if self.found.failure is not None or not self._is_open.is_set():
            return self.found.health
        try:
            return self._device.driver.health()
        except Exception as error:  # noqa: BLE001  # a driver's mistake is found like any other
            self.found.failure = error
            return self.found.health

    def _run(self) -> None:
        driver = self._device.driver
        try:
            driver.open()
            self._find_streams()
            self._is_open.set()
            by_port = {stream.port.name: stream for stream in self.found.streams.values()}
            while not self._window.over.is_set():
                for item in driver.read(_READ_S):
                    if isinstance(item, Event):
                        self.found.events[item.name] = item
                    elif item.port in by_port and self._window.holds(item.time_host_ns):
                        by_port[item.port].take(item, self._window.every_ns)
        except Exception as error:  # noqa: BLE001  # whatever it is, the others are watched on
            self.found.failure = error
        finally:
            self._is_open.set()
            self._close()

    def _find_streams(self) -> None:
        ports = {port.name: port for port in self._device.driver.ports}
        wrong = [name for name in self._device.streams if name not in ports]
        if wrong:
            raise DeviceError(
                f"it has no port {', '.join(map(repr, wrong))}",
                fix=f"Correct `streams` in the rig file; its ports are {', '.join(sorted(ports))}.",
            )
        self.found.streams = {
            name: ProbedStream(name, self.found.name, ports[port])
            for port, name in self._device.streams.items()
        }

    def _close(self) -> None:
        try:
            self._device.driver.close()
        except Exception as error:  # noqa: BLE001  # said, unless there is worse
            self.found.failure = self.found.failure or error


def _more(before: Mapping[str, int], after: Mapping[str, int]) -> dict[str, int]:
    """Return what was counted in between; what was missed before it may have come late."""
    since = {cause: number - before.get(cause, 0) for cause, number in after.items()}
    return {cause: n for cause, n in since.items() if n > 0}
