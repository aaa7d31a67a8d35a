"""Finding USB devices as the kernel lists them."""

from pathlib import Path

import pytest

from exumi_recorders.contract import DeviceError
from exumi_recorders.drivers.tac02 import Tac02, Tac02Options
from exumi_recorders.drivers.usb_endpoint import UsbDevice, UsbEndpoint, find_devices


def plug(sysfs: Path, name: str, product: str, serial: str | None = None) -> None:
    """Write what Linux lists for a device with two interfaces."""
    files = {"idVendor": "2fe3", "idProduct": product, "busnum": "1", "devnum": "7"}
    folder = sysfs / name
    for number, endpoint in enumerate(("ep_82", "ep_81")):
        (folder / f"{name}:1.{number}" / endpoint).mkdir(parents=True)
        (folder / f"{name}:1.{number}" / "bInterfaceNumber").write_text(f"0{number}\n")
    for key, text in files.items() if serial is None else [*files.items(), ("serial", serial)]:
        (folder / key).write_text(f"{text}\n")
    (sysfs / f"{name}:1.0").mkdir()  # interfaces are listed beside devices, too


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_device_is_found_by_its_numbers(tmp_path: Path) -> None:
    plug(tmp_path, "1-2", "0100", "A17")
    plug(tmp_path, "1-3", "0102")
    (device,) = find_devices(0x2FE3, 0x0100, sysfs=tmp_path)
    assert device == UsbDevice(Path("/dev/bus/usb/001/007"), "A17", {0x82: 0, 0x81: 1})
    (other,) = find_devices(0x2FE3, 0x0102, sysfs=tmp_path)
    assert other.serial is None
    assert find_devices(0x2FE3, 0x0103, sysfs=tmp_path) == []


def test_an_endpoint_that_is_not_there() -> None:
    with pytest.raises(DeviceError, match="no endpoint 0x81"):
        UsbEndpoint(UsbDevice(Path("/dev/bus/usb/001/007"), None, {0x82: 0}), 0x81)


def test_a_file_that_is_no_device_is_closed_again(tmp_path: Path) -> None:
    node = tmp_path / "007"
    node.touch()
    before = open_files()
    with pytest.raises(DeviceError, match="cannot be claimed"):
        UsbEndpoint(UsbDevice(node, None, {0x81: 1}), 0x81)
    assert open_files() == before


@pytest.mark.parametrize(
    ("serials", "said"),
    [
        ([], "USB 2fe3:0100: there is no such device. Is it plugged in"),
        (["A", "B"], "there are 2 such devices. Say which with `serial`: A, B"),
    ],
)
def test_which_device_is_meant(
    serials: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, serial in enumerate(serials):
        plug(tmp_path, f"1-{number}", "0100", serial)
    monkeypatch.setattr(find_devices, "__kwdefaults__", {"sysfs": tmp_path})
    with pytest.raises(DeviceError, match=said):
        Tac02(Tac02Options(side="left")).open()
