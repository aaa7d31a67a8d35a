"""Rig files to begin with: each of them loads; nothing is overwritten; devices are listed."""

import re
from pathlib import Path

import pytest

from exumi_data.errors import UsageError
from exumi_recorders.rig.loading import load_rig
from exumi_recorders.rig.starting import TEMPLATES, present_devices, template, write_template

STREAMS = {
    "exumi": {"pose", "width", "tactile_left", "tactile_right", "rgb"},
    "tmi": {"tactile", "taxels"},
    "simulated": {"width"},
}


@pytest.mark.parametrize("name", TEMPLATES)
def test_each_loads_as_it_is(tmp_path: Path, name: str) -> None:
    rig = load_rig(write_template(name, tmp_path / "new" / "rig.toml"))
    assert set(rig.stream_names) == STREAMS[name]
    for device in rig.devices:
        ports = {port.name for port in device.driver.make(device.options).ports}
        assert set(device.streams) <= ports


@pytest.mark.parametrize("name", TEMPLATES)
def test_each_loads_with_all_choices_made(tmp_path: Path, name: str) -> None:
    """What is commented out is right as well: tables of their own, and settings."""
    lines: list[str] = []
    for line in template(name).splitlines():
        setting = re.match(r"# ((\[[\w.]+\])|(\w+ = .*))$", line)
        header = setting is not None and setting[2] is not None
        if header and setting is not None and setting[2] in lines:
            break  # one in place of another
        lines.append(setting[1] if setting else line)
    path = tmp_path / "rig.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    assert set(load_rig(path).stream_names) >= STREAMS[name]


def test_nothing_is_overwritten_unless_it_is_said(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(UsageError, match="there already"):
        write_template("exumi", path)
    assert path.read_text("utf-8") == "mine"
    (tmp_path / "link.toml").symlink_to("gone.toml")
    with pytest.raises(UsageError, match="there already"):
        write_template("exumi", tmp_path / "link.toml")
    write_template("exumi", path, force=True)
    assert path.read_text("utf-8") == template("exumi")


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"exumi, tmi, simulated"):
        write_template("umi", tmp_path / "rig.toml")
    with pytest.raises(UsageError, match="TOML"):
        write_template("exumi", tmp_path / "rig.yaml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(UsageError, match="there already"):
        write_template("exumi", tmp_path / "folder.toml", force=True)
    with pytest.raises(UsageError, match="no rig file for"):
        template("../../model")


def make(root: Path, **files: str) -> None:
    for name, content in files.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")


def test_what_is_plugged_in_is_listed(tmp_path: Path) -> None:
    assert present_devices(tmp_path).lines() == []
    make(
        tmp_path,
        sys__class__video4linux__video0__name="9DTact",
        sys__class__video4linux__video0__device__idVendor="1bcf",
        sys__class__video4linux__video0__device__idProduct="2cd1",
        sys__class__video4linux__video0__device__serial="SN0001",
        sys__bus__usb__devices__hub__idVendor="2fe3",
        sys__bus__usb__devices__hub__idProduct="0102",
        sys__bus__usb__devices__hub__busnum="1",
        sys__bus__usb__devices__hub__devnum="4",
    )
    for name in ("i2c-1", "i2c-7", "ttyUSB0", "serial/by-id/usb-Acme_Cell"):
        make(tmp_path, **{f"dev__{name.replace('/', '__')}": ""})
    found = present_devices(tmp_path)
    assert [camera.usb_id for camera in found.cameras] == ["1bcf:2cd1"]
    assert found.i2c_buses == ("/dev/i2c-1", "/dev/i2c-7")
    assert found.serial_ports == ("/dev/serial/by-id/usb-Acme_Cell",)
    assert found.tac02 == ("right",)
    assert len(found.lines()) == 5
    (tmp_path / "dev/serial/by-id/usb-Acme_Cell").unlink()
    assert present_devices(tmp_path).serial_ports == ("/dev/ttyUSB0",)
