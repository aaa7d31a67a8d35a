"""Through PyAV: packets as they are, here from a file in place of a camera."""

import itertools
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from exumi_data.store import jpeg
from exumi_recorders.contract import DeviceError, DeviceLostError, Event, Sample
from exumi_recorders.drivers.camera import CameraDriver, CameraOptions, Shape
from exumi_recorders.drivers.camera_profiles import PROFILES
from exumi_recorders.drivers.pyav_camera import PyavSource

START_US = 7_000_000_000


def files(count: int) -> list[bytes]:
    rng = np.random.default_rng(0)
    return [jpeg.encode(rng.integers(0, 255, (48, 64, 3), np.uint8), 90) for _ in range(count)]


def camera_file(path: Path, pictures: list[bytes]) -> Path:
    """Write a file of MJPEG packets, whose pts count microseconds as V4L2's do."""
    with av.open(path, "w", format="nut") as container:
        stream = container.add_stream("mjpeg", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        for number, data in enumerate(pictures):
            packet = av.Packet(data)
            packet.stream, packet.time_base = stream, Fraction(1, 1_000_000)
            packet.pts = packet.dts = START_US + number * 33_333
            container.mux(packet)
    return path


def driver(tmp_path: Path, pictures: list[bytes], now_ns: int, **options: Any) -> CameraDriver:
    path = camera_file(tmp_path / "camera.nut", pictures)
    given = CameraOptions(device=str(path), width=64, height=48, start_timeout_s=2, **options)

    def source() -> PyavSource:
        return PyavSource(
            given.device,
            controls=given.controls,
            open_container=lambda name, _: av.open(name),
            monotonic_ns=lambda: now_ns,
        )

    ticks = iter(range(now_ns, now_ns + 10**12, 10**6))
    return CameraDriver(PROFILES["uvc"], given, (source,), lambda: next(ticks))


def read_all(camera: CameraDriver) -> list[Sample | Event]:
    found: list[Sample | Event] = []
    try:
        while True:
            found += camera.read(0.2)
    except DeviceLostError:
        return found


def test_bytes_and_stamps_are_kept_and_losses_are_not_known(tmp_path: Path) -> None:
    pictures = files(20)
    camera = driver(tmp_path, pictures, (START_US + 1_000_000) * 1000, controls={"gain": 3})
    camera.open()
    found = [item for item in read_all(camera) if isinstance(item, Sample)]
    assert [sample.payload for sample in found] == pictures
    # The file's time base is not quite a microsecond.
    stamps_us = [sample.time_host_ns / 1000 for sample in found]
    expected_us = [START_US + number * 33_333 for number in range(20)]
    np.testing.assert_allclose(stamps_us, expected_us, rtol=0, atol=20)
    assert {sample.sequence for sample in found} == {None}
    (port,) = camera.ports
    assert (port.stamp_point, port.modulus) == ("kernel_rx", None)
    health = camera.health()
    assert health.readings["losses_known"] is False
    assert "controls cannot be set through PyAV: gain" in health.problems
    camera.close()
    camera.close()


def test_pts_of_another_clock_are_no_stamps(tmp_path: Path) -> None:
    now_ns = 10**18
    camera = driver(tmp_path, files(1), now_ns)
    camera.open()
    (sample,) = (item for item in read_all(camera) if isinstance(item, Sample))
    assert camera.ports[0].stamp_point == "user_rx"
    assert sample.time_host_ns == now_ns
    camera.close()


# The thread ends with what nobody expected; the camera is told to be gone all the same.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_reader_that_breaks_is_a_lost_camera(tmp_path: Path) -> None:
    class Broken:
        def __enter__(self) -> "Broken":
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def demux(self, **_: object) -> Any:
            raise KeyError  # nothing that FFmpeg would say

    (tmp_path / "video0").write_bytes(b"")
    source = PyavSource(str(tmp_path / "video0"), controls={}, open_container=lambda *_: Broken())
    source.open(Shape(64, 48, Fraction(30)))
    # Asked before the thread has ended there is nothing yet; after it, even the first tells it.
    with pytest.raises(DeviceLostError, match="is gone"):
        list(itertools.chain.from_iterable(source.read(0.2) for _ in range(100)))
    source.close()


def test_what_ffmpeg_cannot_open(tmp_path: Path) -> None:
    (tmp_path / "video0").write_bytes(b"")
    source = PyavSource(str(tmp_path / "video0"), controls={})
    with pytest.raises(DeviceError, match="cannot open the camera"):
        source.open(Shape(64, 48, Fraction(30)))
    source.close()


def test_it_is_taken_where_the_kernels_calls_fail(tmp_path: Path) -> None:
    """A device that is no V4L2 device to us, but is one to the next."""
    from exumi_recorders.drivers.uvc import V4L2Source

    path = camera_file(tmp_path / "camera.nut", files(3))
    options = CameraOptions(device=str(path), width=64, height=48)
    camera = CameraDriver(
        PROFILES["uvc"],
        options,
        (
            lambda: V4L2Source(str(path), lock={}, controls={}),
            lambda: PyavSource(
                str(path), controls={}, open_container=lambda name, _: av.open(name)
            ),
        ),
        time.monotonic_ns,
    )
    camera.open()
    assert len([item for item in read_all(camera) if isinstance(item, Sample)]) == 3
    camera.close()
