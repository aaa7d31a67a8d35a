"""One thread a device: it opens the driver, reads it, and opens it again when it was lost."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from exumi_recorders.contract import DeviceError, Driver, Event, Files, Health, Port, Sample
from exumi_recorders.finalise.events import DEVICE_BACK, DEVICE_LOST, FROZEN
from exumi_recorders.finalise.losses import KNOWN_FLAGS
from exumi_recorders.journal.record import RESTARTED
from exumi_recorders.recording.status import StreamMeter

if TYPE_CHECKING:
    from exumi_recorders.recording.lanes import Lane

__all__ = ["RESTART", "DeviceThread", "RecordedDevice", "RecordedStream"]

RESTART = "restart"
"""Event of a driver: what comes after it is counted and stamped by the device anew."""
FROZEN_AFTER_NS = 500_000_000

_READ_S = 0.1
_HEALTH_NS = 1_000_000_000
_REOPEN_S = 1.0
_URGENT_HZ = 200.0


@dataclass(frozen=True, slots=True)
class RecordedDevice:
    """A device that takes part in a recording.

    Attributes
    ----------
    name : str
        As in the rig file.
    driver : Driver
        Not open yet.
    streams : mapping of str to str
        What the streams of its ports are called; a port that is not there is not recorded.
    """

    name: str
    driver: Driver
    streams: Mapping[str, str]


class RecordedStream:
    """One stream: its port, its queue while an episode is recorded, and how it is.

    Parameters
    ----------
    name, device : str
    port : Port
    """

    def __init__(self, name: str, device: str, port: Port) -> None:
        from exumi_data.time import parse_rate

        self.name = name
        self.device = device
        self.port = port
        self.meter = StreamMeter()
        self.lane: Lane | None = None
        self.latest: Sample | None = None
        rate = None if port.nominal_rate is None else float(parse_rate(port.nominal_rate))
        self.rate_hz = rate
        self.urgent = rate is None or rate <= _URGENT_HZ
        self.is_image = isinstance(port.payload, Files)
        self._watches_payload = port.kind == "pose"
        self._payload: bytes | None = None
        self._since_ns = 0
        self.frozen = False

    def take(self, sample: Sample, now_ns: int, *, restarted: bool, with_preview: bool) -> None:
        """Take a sample; for the thread of its device.

        Parameters
        ----------
        sample : Sample
        now_ns : int
        restarted : bool
            It is the first since the device was opened anew.
        with_preview : bool
        """
        self.meter.note(sample.time_host_ns, now_ns)
        lane = self.lane
        if lane is not None:
            flags = sample.flags & KNOWN_FLAGS
            lane.put(sample, flags | RESTARTED if restarted else flags, now_ns)
        if self.is_image and with_preview:
            self.latest = sample
        if self._watches_payload:
            self._watch(sample.payload, now_ns)

    def _watch(self, payload: bytes, now_ns: int) -> None:
        """Notice a tracker that says the same again and again."""
        if payload != self._payload:
            self._payload, self._since_ns, self.frozen = payload, now_ns, False
        elif now_ns - self._since_ns > FROZEN_AFTER_NS:
            self.frozen = True


class DeviceThread:
    """Reads one device.

    Parameters
    ----------
    device : RecordedDevice
    on_event : callable
        Told of the device's name and the event.
    wake : callable
        Told when there is something that should be written soon.
    has_room : callable
        Whether the preview may be kept.
    """

    def __init__(
        self,
        device: RecordedDevice,
        *,
        on_event: Callable[[str, Event], None],
        wake: Callable[[], None],
        has_room: Callable[[], bool],
    ) -> None:
        self.name = device.name
        self.streams: dict[str, RecordedStream] = {}
        self.connected = False
        self.trouble: str | None = None
        self.health = Health()
        self._device = device
        self._driver = device.driver
        self._on_event = on_event
        self._wake = wake
        self._has_room = has_room
        self._stop = threading.Event()
        self._ready = threading.Event()
        self._failure: Exception | None = None
        self._health_at = 0
        self._asking = threading.Lock()
        # A driver counts from 0 when it is opened again; an episode does not.
        self._lost_before: Mapping[str, int] = {}
        self._restarted: set[str] = set()
        self._frozen: set[str] = set()
        self._thread = threading.Thread(target=self._run, name=f"device {device.name}", daemon=True)

    def start(self) -> None:
        """Begin to open the device."""
        self._thread.start()

    def wait_until_open(self, timeout_s: float) -> Exception | None:
        """Wait for the device to be open; return why it is not.

        Parameters
        ----------
        timeout_s : float
        """
        if not self._ready.wait(timeout_s):
            return TimeoutError(f"{self.name} did not open within {timeout_s:g} s")
        return self._failure

    def stop(self, timeout_s: float = 5.0) -> None:
        """Close the device.

        Parameters
        ----------
        timeout_s : float
        """
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def health_now(self) -> Health:
        """Ask the driver how the device is; what it said last where it cannot say."""
        try:
            self._ask()
        except Exception as error:  # noqa: BLE001  # a driver's mistake must not end a recording
            self.trouble = _text(error)
        return self.health

    def _ask(self) -> None:
        with self._asking:
            if self.connected:
                said = self._driver.health()
                lost = Counter(self._lost_before) + Counter(said.lost)
                self.health = replace(said, lost=dict(lost))

    def _run(self) -> None:
        try:
            self._driver.open()
            self._find_streams()
            self.connected = True
        except Exception as error:  # noqa: BLE001  # handed to whoever waits
            self._failure = error
            self._close()
            return
        finally:
            self._ready.set()
        while not self._stop.is_set():
            try:
                items = self._driver.read(_READ_S)
                now_ns = time.monotonic_ns()
                if items:
                    self._take(items, now_ns)
                if now_ns - self._health_at > _HEALTH_NS:
                    self._health_at = now_ns
                    self._ask()
            except Exception as error:  # noqa: BLE001  # a lost device, or a driver's mistake: others go on
                self._lost(error)
        self._close()

    def _find_streams(self) -> None:
        ports = {port.name: port for port in self._driver.ports}
        unknown = [repr(name) for name in self._device.streams if name not in ports]
        if unknown:
            raise DeviceError(
                f"has no port {' or '.join(unknown)}, but {', '.join(sorted(ports))}",
                where=self.name,
                fix=f"Correct `streams` of [devices.{self.name}].",
            )
        for port_name, stream in self._device.streams.items():
            self.streams[port_name] = RecordedStream(stream, self.name, ports[port_name])

    def _take(self, items: list[Sample | Event], now_ns: int) -> None:
        urgent = False
        with_preview = self._has_room()
        for item in items:
            if isinstance(item, Event):
                if item.name == RESTART:
                    self._restarted = set(self.streams)
                self._on_event(self.name, item)
                urgent = True
                continue
            stream = self.streams.get(item.port)
            if stream is None:
                continue
            restarted = item.port in self._restarted
            if restarted:
                self._restarted.discard(item.port)
            stream.take(item, now_ns, restarted=restarted, with_preview=with_preview)
            urgent = urgent or stream.urgent
            if stream.frozen != (item.port in self._frozen):
                self._tell_frozen(item.port, stream, now_ns)
        if urgent:
            self._wake()

    def _tell_frozen(self, port: str, stream: RecordedStream, now_ns: int) -> None:
        if stream.frozen:
            self._frozen.add(port)
            self._on_event(self.name, Event(FROZEN, now_ns, {"stream": stream.name}))
        else:
            self._frozen.discard(port)

    def _lost(self, error: Exception) -> None:
        """Say that the device is gone, and open it again each second until it is back."""
        with suppress(Exception):  # it may be why the device is lost
            self._ask()
        with self._asking:
            self.connected = False
            self._lost_before = self.health.lost
        self.trouble = _text(error)
        detail = {"error": self.trouble}
        self._on_event(self.name, Event(DEVICE_LOST, time.monotonic_ns(), detail))
        self._wake()
        self._close()
        while not self._stop.wait(_REOPEN_S):
            try:
                self._driver.open()
            except Exception as again:  # noqa: BLE001  # it may be back the next time
                self.trouble = _text(again)
                self._close()
                continue
            self._restarted = set(self.streams)
            self.connected = True
            self.trouble = None
            self._on_event(self.name, Event(DEVICE_BACK, time.monotonic_ns()))
            self._wake()
            return

    def _close(self) -> None:
        self.connected = False
        try:
            self._driver.close()
        except Exception as error:  # noqa: BLE001  # nothing depends on it any more
            self.trouble = self.trouble or _text(error)


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__
