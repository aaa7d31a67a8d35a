"""Sensors that send lines: by UDP, by a serial port, with what may be wrong with a line."""

import os
import socket
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from exumi_recorders.contract import DeviceError, DeviceLostError, Driver, Port, Rows, Sample
from exumi_recorders.drivers.line import FieldsOptions, LineDriver, LineSource, Reading
from exumi_recorders.drivers.registry import find_driver
from exumi_recorders.testing import check_driver

GRIP = {"columns": [1], "metadata": {"components": ["f_grip"]}}


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def opened(**options: Any) -> Driver:
    kind = find_driver("line")
    driver = kind.make(kind.options.model_validate(options))
    driver.open()
    return driver


def read_all(driver: Driver) -> list[Sample]:
    found: list[Sample] = []
    while items := driver.read(0.05):
        found += [item for item in items if isinstance(item, Sample)]
    return found


def values_of(samples: list[Sample]) -> list[float]:
    values: list[float] = np.frombuffer(b"".join(one.payload for one in samples), "<f4").tolist()
    return values


@contextmanager
def terminal() -> Iterator[tuple[int, str]]:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_it_keeps_the_contract_by_udp() -> None:
    port = free_port()
    ended = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for number in range(1_000_000):
                if ended.wait(0.005):
                    return
                sender.sendto(f"{number},1.5\n".encode(), ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    kind = find_driver("line")
    options = kind.options.model_validate(
        {"udp": port, "address": "127.0.0.1", "sequence_column": 0, "rate_hz": 200, **GRIP}
    )
    try:
        check_driver(lambda: kind.make(options), seconds=0.3)
    finally:
        ended.set()
        thread.join()


def test_a_datagram_is_one_line_or_several() -> None:
    port = free_port()
    driver = opened(udp=port, address="127.0.0.1", scale=0.5, sequence_column=0, **GRIP)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (b"7,3", b"8,4\n9,5\r\n", b""):
            sender.sendto(data, ("127.0.0.1", port))
    samples = read_all(driver)
    driver.close()
    assert values_of(samples) == [1.5, 2.0, 2.5]
    assert [item.sequence for item in samples] == [7, 8, 9]


def test_a_large_datagram_is_read_whole() -> None:
    port = free_port()
    driver = opened(udp=port, address="127.0.0.1", **GRIP)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"0,12345\n" * 1000, ("127.0.0.1", port))
    samples = read_all(driver)
    driver.close()
    assert values_of(samples) == [12345.0] * 1000


def test_a_udp_port_that_is_in_use() -> None:
    port = free_port()
    first = opened(udp=port, address="127.0.0.1", **GRIP)
    with pytest.raises(DeviceError, match=f"UDP port {port}: cannot listen"):
        opened(udp=port, address="127.0.0.1", **GRIP)
    first.close()


def test_a_serial_port_is_opened_in_the_middle_of_a_line() -> None:
    with terminal() as (ours, name):
        driver = opened(port=name, separator=None, **GRIP)
        os.write(ours, b"00 9\r\n1 2.5\r\n2 3")
        samples = read_all(driver)
        os.write(ours, b".5\r\n")
        samples += read_all(driver)
        driver.close()
    assert values_of(samples) == [2.5, 3.5]


def test_lines_that_cannot_be_read_are_counted() -> None:
    with terminal() as (ours, name):
        driver = opened(port=name, **GRIP)
        os.write(ours, b"\n0,1\n0,one\n0\n0,nan\n0,1e99\n\n0,2\n\xff,3\n")
        samples = read_all(driver)
        health = driver.health()
        driver.close()
    assert values_of(samples) == [1.0, 2.0, 3.0]
    assert health.lost == {"rejected": 4}
    assert "4 lines that cannot be read" in health.problems[0]


def test_a_line_without_an_end_takes_no_memory() -> None:
    with terminal() as (ours, name):
        driver = opened(port=name, **GRIP)
        os.write(ours, b"\n")
        for _ in range(20):
            os.write(ours, b"1" * 1000)
            driver.read(0.01)
        os.write(ours, b"\n0,4\n")
        samples = read_all(driver)
        lost = driver.health().lost["rejected"]
        driver.close()
    assert values_of(samples) == [4.0]
    assert lost >= 1


def test_an_unplugged_sensor_is_lost() -> None:
    ours, theirs = os.openpty()
    driver = opened(port=os.ttyname(theirs), **GRIP)
    os.close(theirs)
    os.close(ours)
    with pytest.raises(DeviceLostError):
        driver.read(0.05)
    driver.close()
    with pytest.raises(DeviceError, match="not open"):
        driver.read(0.05)


def test_a_silent_sensor_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exumi_recorders.drivers.line._SILENT_S", 0.05)
    with terminal() as (_, name):
        driver = opened(port=name, **GRIP)
        assert driver.health().problems == ()
        time.sleep(0.1)
        assert driver.health().problems == (f"{name} has sent nothing for a while.",)
        driver.close()


@pytest.mark.parametrize(
    ("kind", "columns", "shape"), [("wrench", [0, 1], (2,)), ("width", [3], ())]
)
def test_the_port_is_as_the_rig_says(kind: str, columns: list[int], shape: tuple[int]) -> None:
    options = FieldsOptions.model_validate(
        {"udp": 9000, "kind": kind, "columns": columns, "rate_hz": 50}
    )
    (port,) = find_driver("line").make(options).ports
    assert port.kind == kind
    assert port.nominal_rate == "50"
    assert isinstance(port.payload, Rows)
    assert dict(port.payload.arrays) == {"data": ("<f4", shape)}


@pytest.mark.parametrize(
    "wrong", [{}, {"udp": 9000, "port": "/dev/ttyUSB0"}, {"udp": 0}, {"udp": 9000, "separator": ""}]
)
def test_wrong_options_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        FieldsOptions.model_validate({**wrong, **GRIP})


def test_a_port_of_other_payloads_is_refused() -> None:
    port = Port(name="a", kind="pose", payload=Rows({"raw": ("<f8", (7,))}), stamp_point="user_rx")
    with pytest.raises(ValueError, match="rows of `data` alone"):
        LineDriver(port, LineSource(udp=9000), lambda _: Reading([0.0]))
