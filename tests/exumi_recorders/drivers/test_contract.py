"""Drivers whose own tests do not run the contract test pass it, too: cameras, sound, headsets."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from exumi_data.store import jpeg
from exumi_recorders.drivers.alsa import SoundDriver, SoundOptions
from exumi_recorders.drivers.camera import CameraDriver, CameraOptions
from exumi_recorders.drivers.camera_profiles import PROFILES, make_camera
from exumi_recorders.drivers.quest import Quest
from exumi_recorders.drivers.quest_options import QuestOptions
from exumi_recorders.drivers.stamped_udp import StampedSocket
from exumi_recorders.drivers.uvc import V4L2Source
from exumi_recorders.simulated import camera, sound
from exumi_recorders.simulated.camera_setup import CameraSetup
from exumi_recorders.simulated.headset import send
from exumi_recorders.simulated.headset_options import HeadsetOptions, SimulatedSession
from exumi_recorders.simulated.headset_plan import plan
from exumi_recorders.simulated.headset_poses import session_truth
from exumi_recorders.simulated.sound import SoundSetup
from exumi_recorders.testing import check_driver
from tests.exumi_recorders.drivers.fake_kernel import FakeKernel, Filled


@contextmanager
def served(socket: str, serve: Callable[[threading.Event], None]) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(stop,))
    thread.start()
    while not Path(socket).exists():
        time.sleep(0.005)
    try:
        yield
    finally:
        stop.set()
        thread.join(5)


def test_a_camera_behind_a_socket(tmp_path: Path) -> None:
    setup = CameraSetup(
        socket=str(tmp_path / "s"),
        epoch_ns=time.monotonic_ns(),
        width=64,
        height=48,
        rate="100",
        bytes_per_frame=6000,
        drop=0.1,
        damage=0.1,
    )
    options = CameraOptions(device=f"unix:{setup.socket}", width=64, height=48, rate="100")
    with served(setup.socket, lambda stop: camera.serve(setup, stop)):
        check_driver(lambda: make_camera(PROFILES["9dtact"], options), seconds=0.3)


def test_a_microphone_behind_a_socket(tmp_path: Path) -> None:
    setup = SoundSetup(
        socket=str(tmp_path / "s"), epoch_ns=time.monotonic_ns(), channels=2, block=480, drop=0.1
    )
    options = SoundOptions(device=f"unix:{setup.socket}", channels=2, block_ms=10)
    with served(setup.socket, lambda stop: sound.serve(setup, stop)):
        check_driver(lambda: SoundDriver(options), seconds=0.3)


def test_a_camera_through_the_kernel(tmp_path: Path) -> None:
    picture = jpeg.encode(np.zeros((48, 64, 3), np.uint8), 80)
    kernel = FakeKernel()
    frames = iter(range(1_000_000))

    def come(one: FakeKernel) -> None:
        time.sleep(0.004)
        one.waiting.append(Filled(picture, time.monotonic_ns(), next(frames)))

    kernel.on_poll = come
    (tmp_path / "video0").touch()
    options = CameraOptions(device=str(tmp_path / "video0"), width=64, height=48)

    def source() -> V4L2Source:
        return V4L2Source(options.device, lock={}, controls={}, io=kernel, system=tmp_path)

    check_driver(lambda: CameraDriver(PROFILES["uvc"], options, (source,)), seconds=0.3)


def test_a_headset() -> None:
    with_port = StampedSocket("127.0.0.1", 0, buffer_bytes=4096, max_bytes=10)
    port = with_port.address[1]
    with_port.close()
    options = HeadsetOptions(
        port=port,
        dialect="d",
        rate_hz=90,
        duration_s=4,
        session=SimulatedSession(seed=3, duration_s=4),
    )
    thread = threading.Thread(
        target=send, args=(options, plan(options, session_truth(options.session)))
    )
    thread.start()
    given = QuestOptions(host="127.0.0.1", port=port, dialect="d")
    check_driver(lambda: Quest(given), seconds=0.3)
    thread.join()
