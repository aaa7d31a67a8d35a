"""A device begins when it is told to, and ends with whoever has started it."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from exumi_recorders.contract import Sample
from exumi_recorders.drivers.camera import CameraOptions
from exumi_recorders.drivers.camera_profiles import PROFILES, make_camera
from exumi_recorders.simulated.started import READY

SIZE = {"width": 64, "height": 48, "rate": "50"}


@pytest.fixture
def camera(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    socket = tmp_path / "rig" / "s"
    socket.parent.mkdir()
    shown = {"shows": "rgb", "live": True, "bands": 1, "exposures": 1, "play": {"duration_s": 3}}
    options = json.dumps({"socket": str(socket), "epoch_ns": 0, **SIZE, **shown})
    command = [sys.executable, "-m", "exumi_recorders.simulated.started", "camera", options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        yield process, socket
        process.kill()


def test_a_camera_waits_for_the_start_of_the_session(
    camera: tuple[subprocess.Popen[bytes], Path],
) -> None:
    process, socket = camera
    assert process.stdout is not None
    assert process.stdin is not None
    assert process.stdout.readline() == READY
    assert not socket.exists()
    epoch_ns = time.monotonic_ns()
    process.stdin.write(b"%d\n" % epoch_ns)
    process.stdin.flush()
    found = frames(socket, 10)
    assert all(sample.time_host_ns > epoch_ns for sample in found)
    process.stdin.close()
    assert process.wait(5) == 0
    # Whoever has started it may have been killed: nobody else would tidy up.
    assert not socket.parent.exists()


def test_it_ends_when_nobody_says_when_to_begin(
    camera: tuple[subprocess.Popen[bytes], Path],
) -> None:
    process, socket = camera
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(20) == 0
    assert not socket.parent.exists()


def frames(socket: Path, count: int) -> list[Sample]:
    end = time.monotonic() + 5
    while not socket.exists() and time.monotonic() < end:
        time.sleep(0.01)
    given: Any = SIZE
    device = make_camera(PROFILES["9dtact"], CameraOptions(device=f"unix:{socket}", **given))
    device.open()
    found: list[Sample] = []
    while len(found) < count and time.monotonic() < end:
        found += [item for item in device.read(0.1) if isinstance(item, Sample)]
    device.close()
    assert len(found) >= count
    return found
