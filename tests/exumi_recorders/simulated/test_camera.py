"""A simulated camera sends what it says, when it says; whoever knows the setup knows the truth."""

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.store import jpeg
from exumi_recorders.contract import DeviceError, DeviceLostError, Sample
from exumi_recorders.drivers.camera import CameraOptions, Shape
from exumi_recorders.drivers.camera_profiles import PROFILES, make_camera
from exumi_recorders.drivers.socket_camera import SocketSource, pack_header
from exumi_recorders.simulated.camera import serve
from exumi_recorders.simulated.camera_setup import CameraSetup, PlaySetup
from exumi_recorders.simulated.pictures import jpeg_of_size, pictures_of
from exumi_recorders.simulated.schedule import Fate
from exumi_recorders.simulated.serving import serve_frames


def setup(tmp_path: Path, **fields: Any) -> CameraSetup:
    given = {"epoch_ns": time.monotonic_ns(), "width": 64, "height": 48, "rate": "100", **fields}
    return CameraSetup(socket=str(tmp_path / "s"), bytes_per_frame=6000, **given)


@contextmanager
def served(camera: CameraSetup) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(camera, stop))
    thread.start()
    while not Path(camera.socket).exists():
        time.sleep(0.005)
    try:
        yield
    finally:
        stop.set()
        thread.join(5)
        assert not thread.is_alive()


def driver(camera: CameraSetup) -> Any:
    options = CameraOptions(
        device=f"unix:{camera.socket}", width=camera.width, height=camera.height, rate=camera.rate
    )
    return make_camera(PROFILES["9dtact"], options)


def record(device: Any, count: int) -> list[Sample]:
    found: list[Sample] = []
    while len(found) < count:
        found += [item for item in device.read(0.1) if isinstance(item, Sample)]
    return found


def counted(fates: list[Fate]) -> dict[str, int]:
    names = {"dropped": "sequence", "damaged": "error", "cut": "rejected"}
    return {names[fate]: number for fate, number in Counter(fates).items() if fate in names}


def test_stamps_and_losses_are_those_of_the_setup(tmp_path: Path) -> None:
    camera = setup(tmp_path, drop=0.1, damage=0.1, cut=0.1, seed=3, buffers=100)
    with served(camera):
        device = driver(camera)
        device.open()
        found = record(device, 60)
        lost = dict(device.health().lost)
        device.close()
    by_stamp = {camera.stamp_ns(k): k for k in range(1000)}
    frames = [by_stamp[sample.time_host_ns] for sample in found]
    first = frames[0] - (found[0].sequence or 0)
    assert [sample.sequence for sample in found] == [k - first for k in frames]
    fates = [camera.fate(k) for k in range(first, frames[-1] + 1)]
    sent = [
        k for k, fate in zip(range(first, frames[-1] + 1), fates, strict=True) if fate == "sent"
    ]
    assert frames == sent
    # What was dropped before the first frame that came leaves no gap to be seen; frames that were
    # refused after the last good one were counted with it, or not yet.
    begin = next(i for i, fate in enumerate(fates) if fate != "dropped")
    later = [camera.fate(frames[-1] + n) for n in range(1, 20)]
    assert lost in [counted((fates + later[:n])[begin:]) for n in range(20)]
    assert {len(sample.payload) for sample in found} == {6000}


def test_a_frame_is_handed_out_after_its_readout(tmp_path: Path) -> None:
    camera = setup(tmp_path, readout_ns=8_000_000)
    with served(camera):
        device = driver(camera)
        device.open()
        record(device, 5)
        ages = []
        for _ in range(20):
            (sample,) = record(device, 1)[-1:]
            ages.append(time.monotonic_ns() - sample.time_host_ns)
        device.close()
    assert min(ages) >= 8_000_000
    assert np.median(ages) < 25_000_000  # of a machine that has other things to do


def test_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    camera = setup(tmp_path, absent_s=((0.4, 0.7),))
    with served(camera):
        device = driver(camera)
        device.open()
        with pytest.raises(DeviceLostError):
            record(device, 1000)
        device.close()
        time.sleep(0.05)
        with pytest.raises(DeviceError, match="no camera serves"):
            device.open()
        time.sleep(max(0.0, 0.8 - (time.monotonic_ns() - camera.epoch_ns) * 1e-9))
        device.open()
        (first, *_) = record(device, 3)
        device.close()
    # It counts anew: its frame 0 was taken after it came back, whichever was read first.
    assert first.sequence is not None
    began_s = (first.time_host_ns - camera.epoch_ns) * 1e-9 - first.sequence * 0.01
    assert began_s > 0.69


def test_a_camera_that_starts_slowly(tmp_path: Path) -> None:
    camera = setup(tmp_path, slow_start_s=0.3)
    with served(camera):
        device = driver(camera)
        before = time.monotonic()
        device.open()
        assert time.monotonic() - before > 0.3
        device.close()


def test_a_reader_that_does_not_keep_up_finds_a_gap(tmp_path: Path) -> None:
    camera = setup(tmp_path, rate="200", buffers=2)
    camera = camera.model_copy(update={"bytes_per_frame": 300_000, "width": 640, "height": 480})
    with served(camera):
        device = driver(camera)
        device.open()
        record(device, 2)
        time.sleep(0.5)
        record(device, 60)
        assert device.health().lost["sequence"] > 20
        device.close()


def test_pictures_that_take_longer_than_a_period_cost_frames_and_not_time(tmp_path: Path) -> None:
    camera = setup(tmp_path)
    file = pictures_of(camera)(0)

    def draw(_: int) -> bytes:
        time.sleep(0.05)
        return file

    stop = threading.Event()
    thread = threading.Thread(target=serve_frames, args=(camera, draw, stop))
    thread.start()
    while not Path(camera.socket).exists():
        time.sleep(0.005)
    source = SocketSource(camera.socket)
    source.open(Shape(camera.width, camera.height, Fraction(100)))
    ages: list[int] = []
    end = time.monotonic() + 20
    while len(ages) < 12 and time.monotonic() < end:
        ages += [time.monotonic_ns() - frame.stamp_ns for frame in source.read(0.5)]
    source.close()
    stop.set()
    thread.join(5)
    assert len(ages) >= 12
    assert ages[-1] < 0.15e9


def test_what_is_no_frame_ends_the_connection(tmp_path: Path) -> None:
    import socket

    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "s"))
    listener.listen(1)
    source = SocketSource(str(tmp_path / "s"))
    source.open(driver(setup(tmp_path))._shape)
    connection, _ = listener.accept()
    connection.sendall(pack_header(1, 2, 3) + b"abc" + b"x" * 28)
    (frame,) = source.read(0.5)
    assert (frame.data, frame.stamp_ns, frame.sequence) == (b"abc", 1, 2)
    with pytest.raises(DeviceLostError, match="is no frame"):
        source.read(0.5)
    with pytest.raises(DeviceLostError, match="is no frame"):
        source.read(0.5)
    source.close()
    with pytest.raises(DeviceError, match="is not open"):
        source.read(0.0)
    connection.close()
    listener.close()


# ----------------------------------------------------------------------------------------- pictures


@pytest.mark.parametrize("size", [6000, 6001, 20_000, 200_003])
def test_a_picture_has_exactly_the_size(size: int) -> None:
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    file = jpeg_of_size(image, size)
    assert len(file) == size
    out = np.empty((48, 64, 3), np.uint8)
    jpeg.decode_into(file, out)


def test_a_picture_that_does_not_fit() -> None:
    image = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    with pytest.raises(ValueError, match="even at the lowest quality"):
        jpeg_of_size(image, 2000)


def decoded(camera: CameraSetup, k: int) -> np.ndarray:
    out = np.empty((camera.height, camera.width, 3), np.uint8)
    jpeg.decode_into(pictures_of(camera)(k), out)
    return out.astype(np.float64)


def test_pictures_show_the_truth_of_their_moment_row_by_row(tmp_path: Path) -> None:
    """With a readout of a whole second, the last rows are those of a second later."""
    play = PlaySetup(duration_s=6.0, seed=2)
    fields: dict[str, Any] = {
        "shows": "tactile_left", "play": play, "rate": "10", "live": True, "quality": 98,
        "height": 60, "width": 80,
    }  # fmt: skip
    still = setup(tmp_path, **fields)
    rolling = setup(tmp_path, **{**fields, "epoch_ns": still.epoch_ns}, readout_ns=10**9, bands=20)
    (grasp, *_) = play.session().grasps
    k = int((grasp.t_contact_s - 0.5) * 10)
    now, later = decoded(still, k), decoded(still, k + 10)
    rows = decoded(rolling, k)
    assert np.abs(now - later)[-6:].mean() > 4 * np.abs(rows - later)[-3:].mean()
    assert np.abs(rows - now)[:3].mean() < np.abs(now - later)[-6:].mean() / 3


def test_the_middle_of_a_picture_is_where_its_latency_says(tmp_path: Path) -> None:
    camera = setup(tmp_path, jitter_ns=0, exposure_ns=4_000_000, readout_ns=12_000_000)
    for k in (0, 7, 1000):
        late_ns = camera.stamp_ns(k) - camera.shown_ns(k)
        assert 0 <= camera.image_latency_ns - late_ns < 1000  # stamps are cut to microseconds
    assert camera.image_latency_ns == 20_000_000 + 2_000_000 - 6_000_000


def test_jitter_and_the_first_frame(tmp_path: Path) -> None:
    camera = setup(tmp_path, jitter_ns=1_000_000, rate="30000/1001")
    clean = camera.model_copy(update={"jitter_ns": 0})
    late = np.array([camera.stamp_ns(k) - clean.stamp_ns(k) for k in range(400)])
    assert 0.8e6 < late.std() < 1.2e6
    assert np.abs(late).max() <= 3_001_000
    assert camera.period == Fraction(10**9) / Fraction(30000, 1001)
    for now_ns in (camera.epoch_ns - 5, camera.epoch_ns + 10**9, camera.exposure_start_ns(40)):
        k = camera.first_frame(now_ns)
        assert camera.exposure_start_ns(k) >= now_ns
        assert k == 0 or camera.exposure_start_ns(k - 1) < now_ns


def test_what_was_drawn_before_repeats_its_last_second(tmp_path: Path) -> None:
    camera = setup(tmp_path, shows="rgb", play=PlaySetup(duration_s=3.0), rate="2")
    pictures = pictures_of(camera)
    assert camera.frames_of_session == 6
    assert [pictures(k) for k in (6, 7, 8)] == [pictures(4), pictures(5), pictures(4)]
    assert pictures(0) != pictures(1)
