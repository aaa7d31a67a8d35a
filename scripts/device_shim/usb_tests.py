"""The taxels' driver by the kernel's USB calls; run by ``run.py``."""

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from served import served_transfers

from exumi_recorders.contract import DeviceLostError, Sample
from exumi_recorders.drivers.tac02 import Tac02, Tac02Options
from exumi_recorders.drivers.tac02_frames import encode
from exumi_recorders.drivers.usb_endpoint import find_devices
from exumi_recorders.testing import check_driver

FRAMES = encode((np.arange(10 * 66).reshape(10, 11, 6) % 4000).astype(np.int16))


@pytest.fixture(autouse=True)
def _plugged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {"idVendor": "2fe3", "idProduct": "0100", "busnum": "1", "devnum": "7"}
    interface = tmp_path / "1-2" / "1-2:1.0"
    (interface / "ep_81").mkdir(parents=True)
    (interface / "bInterfaceNumber").write_text("00\n")
    for name, text in files.items():
        (tmp_path / "1-2" / name).write_text(f"{text}\n")
    monkeypatch.setattr(find_devices, "__kwdefaults__", {"sysfs": tmp_path})


def paced(transfers: Iterator[bytes]) -> Iterator[bytes]:
    for data in transfers:
        time.sleep(0.001)
        yield data


def frames() -> Iterator[bytes]:
    return (FRAMES[start : start + 102] for start in range(0, len(FRAMES), 102))


def test_it_keeps_the_contract() -> None:
    with served_transfers(paced(itertools.cycle(frames()))):
        check_driver(lambda: Tac02(Tac02Options(side="left")), seconds=0.3)


def test_a_transfer_is_a_frame_and_the_end_is_a_loss() -> None:
    driver = Tac02(Tac02Options(side="left"))
    garbled = itertools.chain(frames(), [b"12345"], frames())
    samples: list[Sample] = []

    def read_on() -> None:
        while True:
            samples.extend(item for item in driver.read(0.02) if isinstance(item, Sample))

    with served_transfers(paced(garbled)):
        driver.open()
        with pytest.raises(DeviceLostError, match="USB device is gone"):
            read_on()
    driver.close()
    assert driver.health().lost == {"framing": 1}
    assert len(samples) >= 10
