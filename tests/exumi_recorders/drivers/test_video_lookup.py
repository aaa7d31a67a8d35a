"""A camera is found by what it is, not by the order of plugging."""

from pathlib import Path

import pytest

from exumi_recorders.contract import DeviceError
from exumi_recorders.drivers.video_lookup import find_camera, list_cameras


def plug(system: Path, number: int, port: str, serial: str | None, index: int = 0) -> None:
    """Add a camera to a folder like sysfs."""
    usb = system / "devices" / "pci" / port
    interface = usb / f"{port}:1.0"
    interface.mkdir(parents=True, exist_ok=True)
    (usb / "idVendor").write_text("2b03\n")
    (usb / "idProduct").write_text("f780\n")
    if serial:
        (usb / "serial").write_text(f"{serial}\n")
    node = system / "class" / "video4linux" / f"video{number}"
    node.mkdir(parents=True)
    (node / "name").write_text("9DTact\n")
    (node / "index").write_text(f"{index}\n")
    (node / "device").symlink_to(interface)


def test_the_serial_number_decides_whatever_the_order(tmp_path: Path) -> None:
    plug(tmp_path, 10, "1-1.2", "L01")
    plug(tmp_path, 2, "1-1.3", "R01")
    plug(tmp_path, 3, "1-1.3", "R01", index=1)  # its metadata
    assert [camera.path for camera in list_cameras(tmp_path)] == ["/dev/video2", "/dev/video10"]
    left = find_camera("2B03:F780:L01", tmp_path)
    assert (left.path, left.serial, left.port) == ("/dev/video10", "L01", "1-1.2")
    assert find_camera("2b03:f780:R01", tmp_path).path == "/dev/video2"


def test_two_that_cannot_be_told_apart(tmp_path: Path) -> None:
    plug(tmp_path, 0, "1-1.2", None)
    plug(tmp_path, 1, "1-1.3", None)
    with pytest.raises(DeviceError, match=r"2 cameras are 2b03:f780.*port 1-1.2.*by-path"):
        find_camera("2b03:f780", tmp_path)


@pytest.mark.parametrize("device", ["2b03:0001", "2b03:f780:other", "/dev/videoX", "camera"])
def test_what_is_not_there(tmp_path: Path, device: str) -> None:
    plug(tmp_path, 0, "1-1.2", "L01")
    with pytest.raises(DeviceError, match="no camera") as caught:
        find_camera(device, tmp_path)
    assert caught.value.fix


def test_a_link_leads_to_the_device(tmp_path: Path) -> None:
    device, link = tmp_path / "video0", tmp_path / "by-id"
    device.touch()
    link.symlink_to(device)
    assert find_camera(str(link), tmp_path / "none").path == str(device)


def test_no_camera_at_all(tmp_path: Path) -> None:
    assert list_cameras(tmp_path) == []
    with pytest.raises(DeviceError, match="There are: none"):
        find_camera("1234:5678", tmp_path)
