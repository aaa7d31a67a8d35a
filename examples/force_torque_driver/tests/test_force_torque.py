"""The driver against a sensor on a pseudo-terminal."""

import math
import os
import threading
import time
import tty
import uuid
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from acme_force_torque import parse

from exumi_data import EpisodeWriter
from exumi_data.episode import open_episode
from exumi_data.model import Clock, EpisodeMetadata, Source, Task
from exumi_recorders.contract import Sample
from exumi_recorders.drivers.registry import find_driver
from exumi_recorders.testing import check_driver


def line(count: int, values: list[float]) -> bytes:
    text = f"FT,{count % 65536}," + ",".join(f"{value * 1000:.0f}" for value in values)
    return f"{text}*{sum(text.encode()) % 256:02X}\r\n".encode()


def force(count: int) -> list[float]:
    return [0.0, 0.0, round(math.sin(count / 20), 3), 0.01, 0.0, -0.02]


@pytest.fixture
def port() -> Iterator[str]:
    """A sensor that greets, sends 200 lines a second and garbles one in a hundred."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    ended = threading.Event()

    def send() -> None:
        os.write(ours, b"ACME FT6 ready\r\n")
        for count in range(1_000_000):
            if ended.wait(0.005):
                return
            sent = line(count, force(count))
            os.write(ours, sent if count % 100 else sent.replace(b"FT,", b"FT,9"))

    thread = threading.Thread(target=send)
    thread.start()
    yield os.ttyname(theirs)
    ended.set()
    thread.join()
    os.close(ours)
    os.close(theirs)


def test_it_keeps_the_contract(port: str) -> None:
    kind = find_driver("acme-ft6")
    options = kind.options.model_validate({"port": port})
    check_driver(lambda: kind.make(options), seconds=0.3)


def test_its_samples_become_a_stream_of_an_episode(port: str, tmp_path: Path) -> None:
    kind = find_driver("acme-ft6")
    driver = kind.make(kind.options.model_validate({"port": port}))
    driver.open()
    until = time.monotonic() + 0.4
    samples: list[Sample] = []
    while time.monotonic() < until:
        samples += [item for item in driver.read(0.05) if isinstance(item, Sample)]
    (wrench,) = driver.ports
    driver.close()
    metadata = EpisodeMetadata(
        id=str(uuid.uuid4()),
        task=Task(name="press"),
        regime="play",
        licence="CC0-1.0",
        source=Source(type="simulated", tool="acme-force-torque", tool_version="1.0"),
    )
    rows = np.frombuffer(b"".join(item.payload for item in samples), "<f4").reshape(-1, 6)
    times_ns = np.array([item.time_host_ns for item in samples])
    with EpisodeWriter(tmp_path / "press.zarr", metadata) as writer:
        stream = writer.add_stream(
            "wrist",
            kind=wrench.kind,
            clock=Clock(source="hub_monotonic", stamp_point=wrench.stamp_point),
            sensor=wrench.sensor,
            **wrench.metadata,
        )
        stream.append(times_ns - times_ns[0] + np.arange(len(times_ns)), rows)
    counts = [item.sequence for item in samples]
    with open_episode(tmp_path / "press.zarr") as episode:
        stored = episode.streams["wrist"]
        assert stored.kind == "wrench"
        expected = np.array([force(count) for count in counts if count is not None])
        np.testing.assert_allclose(stored.array("data"), expected, atol=1e-6)
    assert len(counts) > 20


def test_a_garbled_line_is_no_sample() -> None:
    good = line(7, [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]).strip()
    reading = parse(good)
    assert reading is not None
    assert reading.sequence == 7
    assert list(reading.values) == [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    assert parse(b"ACME FT6 ready") is None
    with pytest.raises(ValueError, match="check sum"):
        parse(good.replace(b"1000", b"1001"))
