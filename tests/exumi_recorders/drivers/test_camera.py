"""Frames are taken as they came, or refused and counted; controls hold, or it is told."""

import errno
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.store import jpeg
from exumi_recorders.contract import DeviceError, DeviceLostError, Event, Files, Sample
from exumi_recorders.drivers import v4l2
from exumi_recorders.drivers.camera import CameraDriver, CameraOptions, CameraProfile, frame_fault
from exumi_recorders.drivers.camera_profiles import PROFILES
from exumi_recorders.drivers.uvc import V4L2Source
from tests.exumi_recorders.drivers.fake_kernel import FakeControl, FakeKernel, Filled

EXPOSURE_AUTO, EXPOSURE, GAIN = 0x009A_0901, 0x009A_0902, 0x0098_0913
NOW_NS = 5_000_000_000_000
PERIOD_NS = 33_333_000
PROFILE = CameraProfile(
    "test", "", kind="tactile", width=64, height=48, rate="30", sensor="9dtact",
    lock={"auto_exposure": 1, "focus_automatic_continuous": 0},
)  # fmt: skip


def picture(seed: int = 0, height: int = 48, width: int = 64, channels: int = 3) -> bytes:
    image = np.random.default_rng(seed).integers(0, 255, (height, width, channels), np.uint8)
    return jpeg.encode(image, 90)


def frame(sequence: int, data: bytes | None = None, flags: int = 0) -> Filled:
    stamp_ns = NOW_NS + sequence * PERIOD_NS
    return Filled(picture(sequence) if data is None else data, stamp_ns, sequence, flags)


class Rig:
    """A driver on a kernel, and the hub's clock."""

    def __init__(self, tmp_path: Path, kernel: FakeKernel | None = None, **options: Any) -> None:
        device = tmp_path / "video0"
        device.touch()
        self.now_ns = NOW_NS + 10**9
        self.kernel = kernel or FakeKernel(waiting=[frame(0)])
        given = {"device": str(device), "start_timeout_s": 0.001, **options}
        profile = given.pop("profile", PROFILE)
        self.options = CameraOptions.model_validate(given)
        self.driver = CameraDriver(profile, self.options, (self._source,), self._clock)

    def _clock(self) -> int:
        self.now_ns += 1000
        return self.now_ns

    def _source(self) -> V4L2Source:
        return V4L2Source(
            self.options.device,
            buffers=self.options.buffers,
            lock=PROFILE.lock,
            controls=self.options.controls,
            io=self.kernel,
            system=Path("/nonexistent"),
            monotonic_ns=self._clock,
        )

    def samples(self) -> list[Sample]:
        found = []
        while self.kernel.waiting:
            found += [item for item in self.driver.read(0.0) if isinstance(item, Sample)]
        return found + [item for item in self.driver.read(0.0) if isinstance(item, Sample)]


def test_frames_come_byte_for_byte_with_the_kernels_stamps(tmp_path: Path) -> None:
    rig = Rig(tmp_path, side="left", serial="L01")
    rig.driver.open()
    rig.kernel.waiting += [frame(number) for number in range(1, 12)]
    found = rig.samples()
    assert [sample.payload for sample in found] == [picture(number) for number in range(12)]
    assert [sample.sequence for sample in found] == list(range(12))
    assert [sample.time_host_ns for sample in found] == [
        NOW_NS + number * PERIOD_NS for number in range(12)
    ]
    (port,) = rig.driver.ports
    assert (port.kind, port.stamp_point, port.modulus) == ("tactile", "buffer_soe", 1 << 32)
    assert (port.payload, port.lossy) == (Files(48, 64, 3), None)
    assert port.sensor is not None
    assert (port.sensor.model, port.sensor.side, port.sensor.serial) == ("9dtact", "left", "L01")
    health = rig.driver.health()
    assert (dict(health.lost), health.problems) == ({}, ())
    assert len(rig.kernel.queued) == 8  # every buffer went back
    rig.driver.close()
    rig.driver.close()
    assert (rig.kernel.opened, rig.kernel.closed) == (1, 1)
    assert rig.kernel.calls[-1] == "VIDIOC_STREAMOFF"


def test_what_is_lost_or_refused_is_counted(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.driver.open()
    whole = picture(1)
    rig.kernel.waiting += [
        frame(1, flags=v4l2.BUF_FLAG_ERROR),
        frame(2, whole[: len(whole) // 2]),
        frame(3, b""),
        frame(4, b"\0\0" + whole[2:]),
        frame(5, picture(5, height=40)),
        frame(8),  # 6 and 7 never came
        frame(9, whole + bytes(100)),  # padding at the end is no damage
    ]
    assert [sample.sequence for sample in rig.samples()] == [0, 8, 9]
    assert rig.driver.health().lost == {"error": 1, "rejected": 3, "size": 1, "sequence": 2}


def test_the_sequence_goes_over_its_end(tmp_path: Path) -> None:
    first = Filled(picture(), NOW_NS, (1 << 32) - 1)
    rig = Rig(tmp_path, FakeKernel(waiting=[first]))
    rig.driver.open()
    rig.kernel.waiting += [frame(0), frame(2)]
    rig.kernel.waiting[0].stamp_ns += 10_000
    assert [sample.sequence for sample in rig.samples()] == [(1 << 32) - 1, 0, 2]
    assert rig.driver.health().lost == {"sequence": 1}


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC | v4l2.BUF_FLAG_TSTAMP_SRC_SOE, "buffer_soe"),
        (v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC, "kernel_rx"),
        (v4l2.BUF_FLAG_TSTAMP_SRC_SOE, "user_rx"),
        (0x4000, "user_rx"),  # copied from somewhere
    ],
)
def test_the_stamp_point_is_what_the_buffers_say(tmp_path: Path, flags: int, expected: str) -> None:
    rig = Rig(tmp_path, FakeKernel(waiting=[frame(0)], buffer_flags=flags))
    rig.driver.open()
    (sample,) = rig.samples()
    assert rig.driver.ports[0].stamp_point == expected
    assert (sample.time_host_ns == NOW_NS) == (expected != "user_rx")


def test_a_wall_clock_that_is_called_monotonic_is_not_believed(tmp_path: Path) -> None:
    wall = Filled(picture(), 1_780_000_000_000_000_000, 0)
    rig = Rig(tmp_path, FakeKernel(waiting=[wall]))
    rig.driver.open()
    (sample,) = rig.samples()
    assert rig.driver.ports[0].stamp_point == "user_rx"
    assert abs(sample.time_host_ns - rig.now_ns) < 10**6


def test_a_stamp_of_the_future_or_of_before_is_refused(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.driver.open()
    rig.kernel.waiting += [frame(1), frame(2), frame(3)]
    rig.kernel.waiting[0].stamp_ns = NOW_NS
    rig.kernel.waiting[1].stamp_ns = rig.now_ns + 10**9
    assert [sample.sequence for sample in rig.samples()] == [0, 3]
    assert rig.driver.health().lost == {"stamp": 2}


def test_controls_are_locked_read_back_and_logged(tmp_path: Path) -> None:
    kernel = FakeKernel(
        waiting=[frame(0)],
        controls=[
            FakeControl(EXPOSURE_AUTO, b"Auto Exposure", 3),
            FakeControl(EXPOSURE, b"Exposure Time, Absolute", 156),
            FakeControl(GAIN, b"Gain", 0, maximum=100, holds=False),
            FakeControl(0x0A04_6D01, b"LED1 Mode!", 2),
        ],
    )
    controls = {"exposure_absolute": 80, "gain": 30, "led1_mode": 1, "focus_absolute": 5}
    rig = Rig(tmp_path, kernel, controls=controls)
    rig.driver.open()
    event = rig.driver.read(0.0)[0]
    assert isinstance(event, Event)
    assert event.name == "controls"
    assert event.detail == {
        "auto_exposure": 1,
        "exposure_time_absolute": 80,
        "gain": 0,
        "led1_mode": 1,
    }
    taken, absent = sorted(rig.driver.health().problems)
    assert "has no control 'focus_absolute'" in absent + taken
    assert "gain did not take 30: it is 0" in absent + taken
    assert rig.driver.health().readings["exposure_time_absolute"] == 80


def test_a_control_beyond_its_range_and_one_that_the_start_undoes(tmp_path: Path) -> None:
    auto = FakeControl(EXPOSURE_AUTO, b"Auto Exposure", 3)

    def forget(kernel: FakeKernel) -> None:
        auto.value, kernel.on_poll = 3, None

    kernel = FakeKernel(
        waiting=[frame(0)],
        controls=[auto, FakeControl(GAIN, b"Gain", 0, maximum=100)],
        on_poll=forget,
    )
    rig = Rig(tmp_path, kernel, controls={"gain": 101})
    rig.driver.open()
    assert auto.value == 1
    assert rig.driver.health().problems == ("the control gain cannot be 101: from 0 to 100",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 65}, "does not offer 65x48 @ 30.*MJPG 64x48 @ 30, 15; MJPG 1280x720 @ 30"),
        ({"rate": "25"}, "does not offer 64x48 @ 25"),
    ],
)
def test_what_is_not_offered_is_told_with_what_is(
    tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    rig = Rig(tmp_path, **options)
    with pytest.raises(DeviceError, match=message):
        rig.driver.open()
    assert rig.kernel.closed == 1


def test_a_rate_that_the_camera_changes(tmp_path: Path) -> None:
    rig = Rig(tmp_path, FakeKernel(waiting=[frame(0)], rate_given=Fraction(15)))
    with pytest.raises(DeviceError, match="gives 15 images/s where 30"):
        rig.driver.open()


@pytest.mark.parametrize(
    ("call", "number", "message"),
    [
        (v4l2.VIDIOC_REQBUFS, errno.EBUSY, "Another program uses it"),
        (v4l2.VIDIOC_STREAMON, errno.ENOSPC, "no bandwidth left"),
        (v4l2.VIDIOC_STREAMON, errno.EIO, "does not start"),
        (v4l2.VIDIOC_S_FMT, errno.EINVAL, "takes no format"),
        (v4l2.VIDIOC_QUERYCAP, errno.ENOTTY, "is no V4L2 device"),
    ],
)
def test_what_goes_wrong_when_it_is_opened(
    tmp_path: Path, call: int, number: int, message: str
) -> None:
    rig = Rig(tmp_path, FakeKernel(waiting=[frame(0)], failing={call: number}))
    with pytest.raises(DeviceError, match=message):
        rig.driver.open()
    assert rig.kernel.closed == 1


def test_with_too_few_buffers_images_would_be_lost(tmp_path: Path) -> None:
    rig = Rig(tmp_path, FakeKernel(most_buffers=3))
    with pytest.raises(DeviceError, match="gives 3 buffers"):
        rig.driver.open()
    assert rig.kernel.closed == 1


def test_a_camera_that_sends_nothing_or_rubbish(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="sent no image within"):
        Rig(tmp_path, FakeKernel()).driver.open()
    bad = FakeKernel(waiting=[frame(0, b"rubbish")])
    with pytest.raises(DeviceError, match="refused: 1 rejected"):
        Rig(tmp_path, bad).driver.open()
    with pytest.raises(DeviceError, match="sends images of 64x40, 64x48 was asked for"):
        Rig(tmp_path, FakeKernel(waiting=[frame(0, picture(0, height=40))])).driver.open()


def test_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.driver.open()
    rig.kernel.waiting += [frame(1)]
    assert len(rig.samples()) == 2
    rig.kernel.gone = True
    with pytest.raises(DeviceLostError, match="is gone"):
        rig.driver.read(0.0)
    rig.driver.close()
    with pytest.raises(DeviceError, match="cannot open the camera"):
        rig.driver.open()
    rig.kernel.gone = False
    rig.kernel.waiting.append(frame(0))
    rig.driver.open()
    assert [sample.sequence for sample in rig.samples()] == [0]
    assert dict(rig.driver.health().lost) == {}  # since it was opened


def test_silence_is_a_problem(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.driver.open()
    rig.now_ns += 3 * 10**9
    assert rig.driver.read(0.0)[-1:] != []  # the first image was kept
    assert rig.driver.read(0.0) == []
    assert rig.driver.health().problems == ("no image for 3 s",)


def test_a_grey_camera(tmp_path: Path) -> None:
    rig = Rig(tmp_path, FakeKernel(waiting=[frame(0, picture(channels=1))]))
    rig.driver.open()
    assert getattr(rig.driver.ports[0].payload, "channels", None) == 1


@pytest.mark.parametrize("padding", [0, 32])
def test_yuyv_becomes_jpeg_with_the_same_planes_and_says_so(tmp_path: Path, padding: int) -> None:
    row = np.tile(np.array([120, 90, 120, 160], np.uint8), 32)  # Y U Y V: one even colour
    line = np.concatenate([row, np.zeros(padding, np.uint8)])
    pixels = np.tile(line, (48, 1)).tobytes()
    kernel = FakeKernel(
        modes={v4l2.FOURCC_YUYV: [(64, 48, [30])]},
        waiting=[frame(0, pixels), frame(1, pixels[:-200])],
        line_padding=padding,
    )
    rig = Rig(tmp_path, kernel)
    rig.driver.open()
    (sample,) = rig.samples()
    out = np.empty((48, 64, 3), np.uint8)
    jpeg.decode_into(sample.payload, out)
    blue = 120 + 1.772 * (90 - 128)
    red = 120 + 1.402 * (160 - 128)
    assert np.abs(out[..., 0] - red).max() < 3
    assert np.abs(out[..., 2] - blue).max() < 3
    assert rig.driver.ports[0].lossy == "YUYV to JPEG 4:2:2 of quality 95"
    assert rig.driver.health().lost == {"rejected": 1}


def test_profiles_know_what_their_cameras_offer(tmp_path: Path) -> None:
    assert set(PROFILES) == {"uvc", "9dtact", "gelsight-mini", "digit", "hdmi"}
    rig = Rig(tmp_path, profile=PROFILES["digit"], width=640, height=480, rate="60")
    with pytest.raises(DeviceError, match=r"a digit gives no 640x480 @ 60.*320x240 @ 60"):
        rig.driver.open()


def test_what_is_no_whole_jpeg() -> None:
    whole = picture()
    assert frame_fault(whole, (48, 64)) is None
    assert frame_fault(whole, (64, 48)) == "size"
    assert frame_fault(b"\xff\xd8" + b"x" * 50 + b"\xff\xd9", (48, 64)) == "rejected"
