"""A simulated microphone: its blocks show the truth at the times they say."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from exumi_recorders.contract import Sample
from exumi_recorders.drivers.alsa import SoundDriver, SoundOptions
from exumi_recorders.simulated.sound import SoundSetup, block_of, serve


@pytest.mark.parametrize("drift_ppm", [0.0, 500.0])
def test_a_click_is_heard_at_every_whole_second(drift_ppm: float) -> None:
    setup = SoundSetup(socket="", epoch_ns=10**12, jitter_ns=0, drift_ppm=drift_ppm, seed=5)
    for second in (1, 30):
        k = setup.first_frame(setup.epoch_ns + second * 10**9 - 30_000_000)
        sound = np.concatenate(
            [np.frombuffer(block_of(setup, n), "<i2").astype(float) for n in range(k, k + 3)]
        )
        loud = int(np.argmax(np.abs(sound) > 2000))
        heard_ns = setup.stamp_ns(k) - setup.latency_ns + loud / float(setup.true_rate) * 1e9
        assert abs(heard_ns - setup.epoch_ns - second * 10**9) < 50_000


def test_blocks_come_through_the_socket_with_their_losses(tmp_path: Path) -> None:
    setup = SoundSetup(
        socket=str(tmp_path / "s"), epoch_ns=time.monotonic_ns(), channels=2, block=480, drop=0.1,
        cut=0.05, seed=1, buffers=100,
    )  # fmt: skip
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(setup, stop))
    thread.start()
    while not Path(setup.socket).exists():
        time.sleep(0.005)
    driver = SoundDriver(SoundOptions(device=f"unix:{setup.socket}", channels=2, block_ms=10))
    driver.open()
    found: list[Sample] = []
    while len(found) < 40:
        found += [item for item in driver.read(0.1) if isinstance(item, Sample)]
    driver.close()
    stop.set()
    thread.join(5)
    frames = {setup.stamp_ns(k): k for k in range(1000)}
    numbers = [frames[block.time_host_ns] for block in found]
    kept = [k for k in range(numbers[0], numbers[-1] + 1) if setup.fate(k) == "sent"]
    # A block that was cut to a whole number of samples is one still.
    cut = [k for k in range(numbers[0], numbers[-1] + 1) if setup.fate(k) == "cut"]
    assert sorted({*kept, *cut}) == numbers
    assert driver.health().lost["sequence"] > 0
    for block, k in zip(found, numbers, strict=True):
        if k in kept:
            assert block.payload == block_of(setup, k)
