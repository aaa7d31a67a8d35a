"""A wrong driver fails the contract test for its own reason, and a right one passes."""

import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from exumi_data.store import jpeg
from exumi_recorders.contract import (
    Blocks,
    DeviceError,
    Event,
    Files,
    Health,
    Port,
    Rows,
    Sample,
)
from exumi_recorders.testing import check_driver

PORT = Port(
    name="force",
    kind="wrench",
    payload=Rows({"data": ("<f4", (2,))}),
    stamp_point="user_rx",
    nominal_rate="100",
    metadata={"components": ["fx", "fy"]},
)
ROW = np.zeros(2, "<f4").tobytes()
PICTURE = jpeg.encode(np.zeros((4, 6, 3), np.uint8), 80)


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exumi_recorders.testing._AGAIN_S", 0.1)


def now() -> int:
    return time.monotonic_ns()


@dataclass
class Gauge:
    """A right driver; whatever is set otherwise makes it wrong."""

    port: Port = PORT
    change: Callable[[Sample], Any] = lambda sample: sample
    extra: Callable[[], Any] | None = None
    status: Callable[[], Any] = Health
    wait: bool = True
    longer_s: float = 0.0
    on_second_open: type[Exception] | None = None
    on_close: Callable[["Gauge"], None] = lambda _: None
    on_open: Callable[["Gauge"], None] = lambda _: None
    more_ports: tuple[Port, ...] = ()
    is_open: bool = False
    closed: int = 0
    opened: int = 0
    taken: int = 0
    lost: dict[str, int] = field(default_factory=dict)

    @property
    def ports(self) -> tuple[Port, ...]:
        return (self.port, *self.more_ports)

    def open(self) -> None:
        if self.is_open and self.on_second_open:
            raise self.on_second_open("it is open")
        self.on_open(self)
        self.is_open = True
        self.opened += 1

    def read(self, timeout_s: float) -> list[Any]:
        if not self.wait:
            return []
        time.sleep(min(timeout_s, 0.01) + self.longer_s)
        self.taken += 1
        items = [self.change(Sample("force", now(), ROW))]
        return items + ([self.extra()] if self.extra else [])

    def health(self) -> Any:
        return self.status()

    def close(self) -> None:
        self.on_close(self)
        self.closed += 1
        self.is_open = False


class Stuck(Gauge):
    """It stamps everything with the time at which it was opened."""

    def open(self) -> None:
        super().open()
        at = now()
        self.change = lambda sample: replace(sample, time_host_ns=at)


def problems_of(make: Callable[[], Any], seconds: float = 0.12) -> str:
    with pytest.raises(AssertionError) as caught:
        check_driver(make, seconds=seconds)
    return str(caught.value)


def with_port(**changes: Any) -> Callable[[], Gauge]:
    return lambda: Gauge(port=replace(PORT, **changes))


def with_sample(**changes: Any) -> Callable[[], Gauge]:
    return lambda: Gauge(change=lambda sample: replace(sample, **changes))


def with_health(**changes: Any) -> Callable[[], Gauge]:
    return lambda: Gauge(status=lambda: Health(**changes))


def event(**changes: Any) -> Callable[[], Gauge]:
    return lambda: Gauge(extra=lambda: replace(Event("key", now(), {"name": "space"}), **changes))


@pytest.mark.parametrize("refusal", [None, DeviceError])
def test_a_right_driver_passes(refusal: type[Exception] | None) -> None:
    check_driver(lambda: Gauge(on_second_open=refusal), seconds=0.12)


def test_events_are_no_samples_and_pass() -> None:
    check_driver(event(), seconds=0.12)


WRONG_PORTS: Mapping[str, Callable[[], Gauge]] = {
    "its name does not match": with_port(name="Force 1"),
    "only images and sound may be dropped": with_port(droppable=True),
    "is not a rational": with_port(nominal_rate="59.94"),
    "modulus 1 is less than 2": with_port(modulus=1),
    "is no unit of time": with_port(time_device_unit="mm"),
    "kind 'torsion' is not of the registry": with_port(kind="torsion"),
    "its rows hold raw, not data": with_port(payload=Rows({"raw": ("<u2", (2,))})),
    "not raw alone": with_port(kind="width", transform="encoder_map"),
    "unknown data type": with_port(payload=Rows({"data": ("<q9", (2,))})),
    "say the order of its bytes": with_port(payload=Rows({"data": ("f4", (2,))})),
    "data is float64, not float32": with_port(payload=Rows({"data": ("<f8", (2,))})),
    "its metadata: wrench.components": with_port(metadata={}),
    "valid is of [1, 2] cells, the grid of [2, 1]": with_port(
        kind="taxels", valid=((True, True),), metadata={"grid": [2, 1], "unit": "adc"}
    ),
    "stamp_point 'nominal_rate' is none": with_port(stamp_point="nominal_rate"),
    "stamp_point 'sometime' is none": with_port(stamp_point="sometime"),
    "a sample has shape (2,), expected ()": with_port(kind="width", metadata={}),
    "a stream of kind rgb has no blocks of sound": with_port(
        kind="rgb", payload=Blocks(2, "48000"), metadata={}
    ),
    "2 ports have this name": lambda: Gauge(more_ports=(PORT,)),
}
WRONG_SAMPLES: Mapping[str, Callable[[], Any]] = {
    "its payload has 4 bytes, a row has 8": with_sample(payload=ROW[:4]),
    "its payload is a bytearray, not bytes": with_sample(payload=bytearray(ROW)),
    "its payload is no whole JPEG file": with_port(
        kind="rgb", payload=Files(height=4, width=4, channels=3)
    ),
    "its image is 6x4 with 3 channels, not 4x6 with 3 channels": lambda: Gauge(
        port=replace(PORT, kind="rgb", payload=Files(6, 4, 3), metadata={}),
        change=lambda sample: replace(sample, payload=PICTURE),
    ),
    "is no whole JPEG file": lambda: Gauge(
        port=replace(PORT, kind="rgb", payload=Files(4, 6, 3), metadata={}),
        change=lambda sample: replace(sample, payload=b"\xff\xd8no header\xff\xd9"),
    ),
    "time_host_ns does not go on as time does": Stuck,
    "its sequence is always the same": with_sample(sequence=7),
    "some have a sequence, and some have none": lambda: Gauge(
        extra=lambda: Sample("force", now(), ROW, sequence=1)
    ),
    "some have a device time, and some have none": lambda: Gauge(
        port=replace(PORT, time_device_unit="ns"),
        extra=lambda: Sample("force", now(), ROW, time_device_ns=1),
    ),
    "is no block of 3 channels": with_port(kind="acme:audio", payload=Blocks(3, "48000")),
    "the port 'torque', which is not among its ports": with_sample(port="torque"),
    "time_host_ns is a float, not an int": with_sample(time_host_ns=1.5),
    "lies before open()": with_sample(time_host_ns=5),
    "lies in the future": lambda: Gauge(
        change=lambda sample: replace(sample, time_host_ns=now() + 10**12)
    ),
    "time_host_ns goes back": lambda: Gauge(extra=lambda: Sample("force", now() - 2_000_000, ROW)),
    "flags -1 is no 32-bit number": with_sample(flags=-1),
    "flags has bits 0x80000000": with_sample(flags=1 << 31),
    "sequence does not lie in": with_sample(sequence=-1),
    "its port no time_device_unit": with_sample(time_device_ns=12),
    "time_device_ns is no 64-bit number": with_sample(time_device_ns=1 << 63),
    "a dict among the samples": lambda: Gauge(extra=dict),
}
WRONG_EVENTS: Mapping[str, Callable[[], Any]] = {
    "event 'Key down': its name": event(name="Key down"),
    "event 'key': its detail is not JSON": event(detail={"name": np.float32(1)}),
    "event 'key': time_host_ns lies before open()": event(time_host_ns=1),
}


def slow_health() -> Health:
    time.sleep(0.15)
    return Health()


WRONG_HEALTH: Mapping[str, Callable[[], Any]] = {
    "lost['crc'] is -1, not a count": with_health(lost={"crc": -1}),
    "readings['agc'] is a float": with_health(readings={"agc": math.nan}),
    "readings['agc'] is a list": with_health(readings={"agc": [1]}),
    "not a tuple of sentences": with_health(problems=["too weak"]),
    "stamp_sigma_ns is -1.0": with_health(stamp_sigma_ns=-1.0),
    "health(): it is a dict": lambda: Gauge(status=dict),
    "health() raised ZeroDivisionError": lambda: Gauge(status=lambda: 1 // 0),
    "health() took more than": lambda: Gauge(status=slow_health),
}


@pytest.mark.parametrize("wrong", [WRONG_PORTS, WRONG_SAMPLES, WRONG_EVENTS, WRONG_HEALTH])
def test_what_is_wrong_is_told(wrong: Mapping[str, Callable[[], Any]]) -> None:
    with ThreadPoolExecutor(len(wrong)) as pool:  # they sleep most of the time
        told = dict(zip(wrong, pool.map(problems_of, wrong.values()), strict=True))
    assert {expected: text for expected, text in told.items() if expected not in text} == {}


def test_a_loss_that_is_taken_back() -> None:
    counts = iter(range(1000, 0, -1))
    wrong = problems_of(lambda: Gauge(status=lambda: Health(lost={"crc": next(counts)})))
    assert "lost['crc'] went down" in wrong


def test_a_read_that_takes_longer_than_asked() -> None:
    assert "took more than 0.3 s longer" in problems_of(lambda: Gauge(longer_s=0.4))


def test_a_read_that_does_not_wait() -> None:
    wrong = problems_of(lambda: Gauge(wait=False))
    assert "came back with nothing long before its time was over" in wrong
    assert "no sample came in 0.12 s" in wrong


def test_a_read_that_returns_no_list() -> None:
    class Lazy(Gauge):
        def read(self, timeout_s: float) -> Any:
            return iter(super().read(timeout_s))

    assert "returned a list_iterator, not a list" in problems_of(Lazy)


def test_a_read_that_never_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exumi_recorders.testing._PATIENCE_S", 0.1)
    assert "read(0.05) has not come back" in problems_of(lambda: Gauge(longer_s=3.0))


def test_a_device_that_is_not_there() -> None:
    def absent(_: Gauge) -> None:
        raise DeviceError("there is no such bus")

    assert "open() raised DeviceError: there is no such bus" in problems_of(
        lambda: Gauge(on_open=absent)
    )


def test_an_open_driver_that_breaks_when_it_is_opened() -> None:
    wrong = problems_of(lambda: Gauge(on_second_open=ValueError))
    assert "open() of an open driver raised ValueError: it is open, not a DeviceError" in wrong


def test_ports_that_change_while_it_is_open() -> None:
    class Growing(Gauge):
        @property
        def ports(self) -> tuple[Port, ...]:
            return (PORT, *(replace(PORT, name=f"p{n}") for n in range(self.taken > 0)))

    assert "ports changed while it was open" in problems_of(Growing)


def test_ports_that_are_others_the_next_time() -> None:
    class Changing(Gauge):
        @property
        def ports(self) -> tuple[Port, ...]:
            return (replace(PORT, nominal_rate="100" if self.closed < 3 else "50"),)

    assert "ports are others after close() and open()" in problems_of(Changing)


def test_a_driver_that_takes_long_to_close(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exumi_recorders.testing._CLOSE_S", 0.05)
    wrong = problems_of(lambda: Gauge(on_close=lambda _: time.sleep(0.1)))
    assert "close() took more than 0.05 s" in wrong


def test_a_driver_that_cannot_be_closed_twice_or_unopened() -> None:
    def once(gauge: Gauge) -> None:
        if not gauge.is_open:
            raise KeyError("handle")

    wrong = problems_of(lambda: Gauge(on_close=once))
    assert "close() for a second time raised KeyError" in wrong
    assert "close() of a driver that was never opened raised KeyError" in wrong


def test_a_driver_that_opens_once_only() -> None:
    def once(gauge: Gauge) -> None:
        if gauge.opened > 1:
            raise DeviceError("the port is in use")

    assert "open() after close() raised DeviceError" in problems_of(lambda: Gauge(on_open=once))


def test_a_driver_that_is_silent_once_it_was_opened_again() -> None:
    class Tired(Gauge):
        def read(self, timeout_s: float) -> list[Any]:
            items = super().read(timeout_s)
            return items if self.opened < 3 else []

    assert "no sample came after close() and open()" in problems_of(Tired)


def test_everything_is_told_at_once() -> None:
    wrong = problems_of(
        lambda: Gauge(
            port=replace(PORT, droppable=True),
            change=lambda sample: replace(sample, payload=b"", flags=-1),
        )
    )
    assert len(wrong.splitlines()) == 3
    assert "times)" in wrong
