"""Sound comes in blocks whose times are those of their first samples."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_recorders.contract import DeviceError, DeviceLostError, Sample
from exumi_recorders.drivers.alsa import DRIVER, SoundDriver, SoundOptions
from exumi_recorders.drivers.alsa_pcm import AlsaPcm, OverrunError
from exumi_recorders.drivers.registry import find_driver

START_NS = 10**12
OPTIONS = SoundOptions(device="hw:1", rate=8000, channels=2, block_ms=10)


class FakeCard:
    """A card that has recorded a ramp since `START_NS`."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments
        self.now_ns = START_NS
        self.taken = 0
        self.lost = 0
        self.failure: Exception | None = None
        self.closed = 0

    def __call__(self, *arguments: Any) -> "FakeCard":
        self.arguments = arguments
        return self

    @property
    def waiting(self) -> int:
        return (self.now_ns - START_NS) * 8000 // 10**9 - self.taken - self.lost

    def wait(self, timeout_s: float) -> bool:
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure
        return self.waiting >= 80

    def stamp(self) -> tuple[int, int]:
        return self.waiting, self.now_ns

    def read(self, samples: int) -> bytes:
        count = min(samples, self.waiting)
        ramp = np.arange(self.taken, self.taken + count, dtype="<i2")
        self.taken += count
        return np.stack((ramp, -ramp), axis=1).tobytes()

    def restart(self) -> None:
        self.lost = (self.now_ns - START_NS) * 8000 // 10**9 - self.taken

    def close(self) -> None:
        self.closed += 1


def opened() -> tuple[SoundDriver, FakeCard]:
    card = FakeCard()
    driver = SoundDriver(OPTIONS, card, lambda: card.now_ns)
    driver.open()
    assert card.arguments == ("hw:1", 8000, 2, 80)
    return driver, card


def samples(driver: SoundDriver) -> list[Sample]:
    return [item for item in driver.read(0.0) if isinstance(item, Sample)]


def test_blocks_have_the_time_of_their_first_sample() -> None:
    driver, card = opened()
    card.now_ns += 9_999_000
    assert samples(driver) == []
    card.now_ns += 16_001_000  # 26 ms: two blocks and a half
    first, second = samples(driver)
    assert (first.time_host_ns, second.time_host_ns) == (START_NS, START_NS + 10_000_000)
    assert [len(block.payload) for block in (first, second)] == [320, 320]
    sound = np.frombuffer(second.payload, "<i2").reshape(-1, 2)
    np.testing.assert_array_equal(sound[:, 0], np.arange(80, 160))
    (port,) = driver.ports
    assert (port.kind, port.modulus, port.stamp_point) == ("audio", None, "kernel_rx")
    assert dict(port.metadata) == {"rate": "8000", "channels": 2}
    driver.close()
    driver.close()
    assert card.closed == 1


def test_what_an_overrun_lost_is_counted_by_the_times() -> None:
    driver, card = opened()
    card.now_ns += 20_000_000
    assert len(samples(driver)) == 2
    card.now_ns += 70_000_000
    card.failure = OverrunError()
    assert samples(driver) == []
    card.now_ns += 10_000_000
    (block,) = samples(driver)
    assert block.time_host_ns == START_NS + 90_000_000
    assert driver.health().lost == {"overrun": 7}
    assert driver.health().readings["overruns"] == 1


def test_silence_and_the_end() -> None:
    driver, card = opened()
    card.now_ns += 2_000_000_000
    assert driver.health().problems == ("no sound for 2 s",)
    card.failure = DeviceLostError("gone")
    with pytest.raises(DeviceLostError):
        driver.read(0.0)
    driver.close()
    with pytest.raises(DeviceError, match="is not open"):
        driver.read(0.0)


def test_it_is_registered() -> None:
    assert find_driver("alsa") is DRIVER
    assert isinstance(DRIVER.make(DRIVER.options()), SoundDriver)


# ---------------------------------------------------------------------- ALSA itself, without a card


def library() -> bool:
    try:
        ctypes.CDLL("libasound.so.2")
    except OSError:
        return False
    return True


needs_alsa = pytest.mark.skipif(not library(), reason="needs ALSA's library")


@needs_alsa
def test_the_library_reads_what_a_card_would_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ramp = np.arange(20_000, dtype="<i2")
    (tmp_path / "in.raw").write_bytes(ramp.tobytes())
    configuration = tmp_path / "asound.conf"
    configuration.write_text(
        "pcm.played { type file slave.pcm { type null } file /dev/null "
        f'infile "{tmp_path}/in.raw" format raw }}\n'
    )
    monkeypatch.setenv("ALSA_CONFIG_PATH", str(configuration))
    card = AlsaPcm("played", 48_000, 2, 960)
    assert card.wait(0.1)
    waiting, at_ns = card.stamp()
    assert waiting == 960 * 8
    import time

    assert abs(time.monotonic_ns() - at_ns) < 10**9
    sound = np.frombuffer(card.read(960) + card.read(100), "<i2")
    np.testing.assert_array_equal(sound, ramp[: 2 * 1060])
    card.restart()
    card.close()
    card.close()


@needs_alsa
def test_a_card_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "asound.conf").write_text("")
    monkeypatch.setenv("ALSA_CONFIG_PATH", str(tmp_path / "asound.conf"))
    with pytest.raises(DeviceError, match=r"hw:9 cannot be opened.*arecord -l"):
        AlsaPcm("hw:9", 48_000, 1, 960)
