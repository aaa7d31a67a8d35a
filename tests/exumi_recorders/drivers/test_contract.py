"""Every driver that this package has keeps the contract, with a device that speaks its protocol."""

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from exumi_data.store import jpeg
from exumi_recorders.drivers import v4l2
from exumi_recorders.drivers.alsa import SoundDriver, SoundOptions
from exumi_recorders.drivers.camera import CameraDriver, CameraOptions
from exumi_recorders.drivers.camera_profiles import PROFILES
from exumi_recorders.drivers.pyav_camera import PyavSource
from exumi_recorders.drivers.quest_dialects import Dialect
from exumi_recorders.drivers.quest_options import QuestOptions
from exumi_recorders.drivers.registry import driver_names, find_driver
from exumi_recorders.drivers.uvc import V4L2Source
from exumi_recorders.simulated.camera_setup import CameraSetup
from exumi_recorders.simulated.headset_options import (
    HeadsetFaults,
    HeadsetOptions,
    SimulatedSession,
)
from exumi_recorders.simulated.headset_plan import plan
from exumi_recorders.simulated.headset_poses import session_truth
from exumi_recorders.simulated.pictures import pictures_of
from exumi_recorders.simulated.schedule import FramedSetup
from exumi_recorders.simulated.serving import Content, serve_frames
from exumi_recorders.simulated.sound import SoundSetup, block_of
from exumi_recorders.testing import check_driver
from tests.exumi_recorders.drivers.fake_kernel import FakeControl, FakeKernel, Filled

SECONDS = 0.3
TRUTH = session_truth(SimulatedSession(seed=3, duration_s=3))
PICTURE = jpeg.encode(np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8), 90)
CAMERAS = dict.fromkeys(("uvc", "9dtact", "gelsight-mini", "hdmi"), (64, 48, "100"))
CAMERAS["digit"] = (320, 240, "60")  # it offers nothing smaller
ELSEWHERE = {"as5600", "line", "tac02"}
"""Drivers whose own tests check the contract."""


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def check(name: str, options: dict[str, Any]) -> None:
    kind = find_driver(name)
    given = kind.options.model_validate(options)
    check_driver(lambda: kind.make(given), seconds=SECONDS)


@contextmanager
def served(setup: FramedSetup, content: Content) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=serve_frames, args=(setup, content, stop))
    thread.start()
    while not Path(setup.socket).exists():
        time.sleep(0.005)
    try:
        yield
    finally:
        stop.set()
        thread.join()


def test_no_driver_is_left_out() -> None:
    assert set(driver_names()) == {"quest", "alsa", *CAMERAS, *ELSEWHERE}


@contextmanager
def headset(dialect: Dialect, **faults: float) -> Iterator[int]:
    """A headset that sends, until the block ends; the port that it sends to."""
    port, stop = free_port(), threading.Event()
    options = HeadsetOptions(
        port=port,
        dialect=dialect,
        duration_s=30.0,
        faults=HeadsetFaults(**faults),  # type: ignore[arg-type]  # one of the four
    )
    planned = plan(options, TRUTH)

    def send() -> None:
        epoch_s = time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            for each in planned:
                if stop.wait(max(0.0, epoch_s + each.send_ns / 1e9 - time.monotonic())):
                    return
                link.sendto(each.data, ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield port
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize("dialect", ["a", "b", "c", "d"])
def test_headsets(dialect: Dialect) -> None:
    with headset(dialect, lost=0.1, late=0.1, twice=0.2) as port:
        check("quest", {"host": "127.0.0.1", "port": port})


def test_a_headset_of_which_nothing_is_taken_keeps_its_reader_waiting() -> None:
    with headset("b") as port:
        driver = find_driver("quest").make(QuestOptions(host="127.0.0.1", port=port, dialect="d"))
        driver.open()
        began = time.monotonic()
        assert driver.read(0.1) == []
        assert 0.1 <= time.monotonic() - began < 2.0
        assert driver.health().lost["rejected_dialect"] > 3
        driver.close()


@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_that_a_socket_serves(name: str, tmp_path: Path) -> None:
    width, height, rate = CAMERAS[name]
    setup = CameraSetup(
        socket=str(tmp_path / "s"), epoch_ns=time.monotonic_ns(), bytes_per_frame=6000,
        width=width, height=height, rate=rate, drop=0.1, damage=0.1, cut=0.1,
    )  # fmt: skip
    with served(setup, pictures_of(setup)):
        device = f"unix:{setup.socket}"
        check(name, {"device": device, "width": width, "height": height, "rate": rate})


def test_cameras_by_the_kernels_calls(tmp_path: Path) -> None:
    (tmp_path / "video0").touch()
    options = CameraOptions(device=str(tmp_path / "video0"), width=64, height=48)
    kernel = FakeKernel(controls=[FakeControl(0x0098_0913, b"Gain", 3)], on_poll=deliver)

    def source() -> V4L2Source:
        return V4L2Source(
            options.device, buffers=4, lock={}, controls={}, io=kernel, system=Path("/nonexistent")
        )

    check_driver(lambda: CameraDriver(PROFILES["uvc"], options, (source,)), seconds=SECONDS)
    assert kernel.opened == kernel.closed


def deliver(kernel: FakeKernel) -> None:
    """Be a camera of a hundred images a second, one in ten of which is damaged."""
    time.sleep(0.01)
    number = len(kernel.calls)
    flags = v4l2.BUF_FLAG_ERROR if number % 10 == 0 else 0
    kernel.waiting.append(Filled(PICTURE, time.monotonic_ns(), number, flags))


def test_cameras_through_pyav(tmp_path: Path) -> None:
    (tmp_path / "video0").touch()
    options = CameraOptions(device=str(tmp_path / "video0"), width=64, height=48)
    threads: list[threading.Thread] = []

    def open_container(*_: object) -> Any:
        theirs, ours = os.pipe()
        threads.append(threading.Thread(target=film, args=(ours,)))
        threads[-1].start()
        container = av.open(f"/dev/fd/{theirs}", format="nut")
        os.close(theirs)
        return container

    def source() -> PyavSource:
        return PyavSource(options.device, controls={}, open_container=open_container)

    check_driver(lambda: CameraDriver(PROFILES["uvc"], options, (source,)), seconds=SECONDS)
    for thread in threads:
        thread.join(5.0)
        assert not thread.is_alive()


def film(pipe: int) -> None:
    """Write packets as FFmpeg makes them of a camera's frames, until nobody reads."""
    with suppress(OSError), av.open(f"/dev/fd/{pipe}", "w", format="nut") as file:
        stream = file.add_stream("mjpeg", rate=100)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        file.start_encoding()
        os.close(pipe)  # the file has its own by now
        while True:
            packet = av.Packet(PICTURE)
            packet.stream, packet.time_base = stream, Fraction(1, 1_000_000)
            packet.pts = packet.dts = time.monotonic_ns() // 1000
            file.mux(packet)
            time.sleep(0.01)


class Card:
    """A sound card of 8000 samples a second that records from when it is opened."""

    def __init__(self, *_: object) -> None:
        self._start_ns = time.monotonic_ns()
        self._taken = 0

    def stamp(self) -> tuple[int, int]:
        now_ns = time.monotonic_ns()
        return (now_ns - self._start_ns) * 8000 // 10**9 - self._taken, now_ns

    def wait(self, timeout_s: float) -> bool:
        until_s = time.monotonic() + timeout_s
        while (ready := self.stamp()[0] >= 80) is False and time.monotonic() < until_s:
            time.sleep(0.001)
        return ready

    def read(self, samples: int) -> bytes:
        self._taken += samples
        return bytes(2 * samples)

    def restart(self) -> None:
        raise AssertionError

    def close(self) -> None:
        pass


def test_sound_cards() -> None:
    options = SoundOptions(device="hw:1", rate=8000, block_ms=10)
    check_driver(lambda: SoundDriver(options, Card), seconds=SECONDS)


def test_sound_that_a_socket_serves(tmp_path: Path) -> None:
    setup = SoundSetup(
        socket=str(tmp_path / "s"), epoch_ns=time.monotonic_ns(),
        channels=2, block=480, drop=0.1, cut=0.1,
    )  # fmt: skip
    with served(setup, lambda k: block_of(setup, k)):
        check("alsa", {"device": f"unix:{setup.socket}", "channels": 2, "block_ms": 10})
