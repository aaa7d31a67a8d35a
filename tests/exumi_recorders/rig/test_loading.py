"""Rig files: what is right is read, everything that is wrong is said at once."""

import os
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ConfigDict

from exumi_data.errors import MetadataError, UsageError
from exumi_recorders.contract import DriverType
from exumi_recorders.drivers.registry import DRIVERS
from exumi_recorders.rig.loading import load_rig

TOML = """
format = "exumi-rig"
version = "1.0"

[rig]
name = "exumi"
licence = "CC-BY-4.0"
calibration = ["calibration/gripper.json"]

[embodiment]
name = "exumi"
max_width_m = 0.08

[controls]
flag = "glove"

[limits]
least_minutes = 5

[hooks]
start = ["aplay", "start.wav"]

[devices.glove]
driver = "glove"
rate_hz = 90
streams = { left = "glove_left", right = "glove_right" }
"""

YAML = """
format: exumi-rig
version: "1.0"
rig: {name: exumi, licence: CC-BY-4.0}
devices:
  glove: {driver: glove, rate_hz: 90, streams: {left: glove_left}}
"""


class Options(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    rate_hz: float
    port: int = 7


def make(options: Options) -> Any:
    raise AssertionError(options)


@pytest.fixture(autouse=True)
def _glove(monkeypatch: pytest.MonkeyPatch) -> None:
    glove = DriverType("glove", "A glove.", Options, make)
    point = EntryPoint("glove", "exumi_fake_glove:GLOVE", DRIVERS)
    monkeypatch.setattr(EntryPoint, "load", lambda _: glove)
    monkeypatch.setattr("exumi_data.plugins.entry_points", lambda **_: [point])


def write(folder: Path, text: str, name: str = "rig.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def problems(folder: Path, text: str, name: str = "rig.toml") -> tuple[str, ...]:
    with pytest.raises(MetadataError) as caught:
        load_rig(write(folder, text, name))
    return caught.value.problems


def test_a_rig_file(tmp_path: Path) -> None:
    rig = load_rig(write(tmp_path, TOML))
    assert rig.about.name == "exumi"
    assert rig.embodiment is not None
    assert rig.embodiment.max_width_m == 0.08
    assert rig.stream_names == ("glove_left", "glove_right")
    assert rig.devices[0].options == Options(rate_hz=90)
    assert rig.limits.least_minutes == 5
    assert rig.hooks.start == ["aplay", "start.wav"]
    assert rig.beside("calibration/gripper.json") == tmp_path / "calibration" / "gripper.json"


def test_the_same_in_yaml(tmp_path: Path) -> None:
    rig = load_rig(write(tmp_path, YAML, "rig.yaml"))
    assert rig.stream_names == ("glove_left",)


def test_mistakes_in_yaml_have_their_lines(tmp_path: Path) -> None:
    text = """format: exumi-rig
version: "1.0"
rig:
  name: x
  licence: 4
  calibration: [a.json, 5]
devices:
  glove: {driver: gluv, streams: {left: one}}
"""
    with pytest.raises(MetadataError) as caught:
        load_rig(write(tmp_path, text, "rig.yaml"))
    found = [problem.split(":")[0] for problem in caught.value.problems]
    assert found == [
        "line 5, rig.licence",
        "line 6, rig.calibration.1",
        "line 8, devices.glove.driver",
    ]
    missing = text.replace("  licence: 4\n", "").replace(", 5]", "]").replace("gluv", "line")
    with pytest.raises(MetadataError) as caught:
        load_rig(write(tmp_path, missing, "rig.yaml"))
    assert "line 3, rig.licence: is missing" in caught.value.problems


def test_everything_that_is_wrong_is_said_with_its_line(tmp_path: Path) -> None:
    text = TOML.replace('licence = "CC-BY-4.0"', "licence = 4").replace(
        "rate_hz = 90", 'rate_hz = "fast"\nrat = 3'
    )
    text = text.replace('flag = "glove"', 'flag = "headset"')
    text += '\n[devices.second]\ndriver = "gluv"\nstreams = { left = "Left" }\n[device]\nx = 1\n'
    found = problems(tmp_path, text)
    lines = text.splitlines()
    for place, word in [
        ("rig.licence", "string"),
        ("devices.glove.rate_hz", "number"),
        ("devices.glove.rat", "no such setting"),
        ("devices.second.driver", "no driver 'gluv'"),
        ("device", "no such section"),
    ]:
        (problem,) = [p for p in found if f" {place}: " in p]
        assert word in problem
        line = int(problem.split(",")[0].removeprefix("line "))
        assert place.rsplit(".", maxsplit=1)[-1] in lines[line - 1]
    assert any("controls.flag: there is no device 'headset'" in p for p in found)
    assert any("devices.second.streams.left: a stream's name" in p for p in found)
    assert len(found) == 7


def test_a_licence_that_spdx_does_not_know(tmp_path: Path) -> None:
    (problem,) = problems(tmp_path, TOML.replace("CC-BY-4.0", "bogus"))
    assert "rig.licence: 'bogus' is no SPDX licence expression" in problem


def test_two_streams_of_one_name(tmp_path: Path) -> None:
    (problem,) = problems(tmp_path, TOML.replace("glove_right", "glove_left"))
    assert "the stream 'glove_left' is that of device 'glove' already" in problem


@pytest.mark.parametrize("name", ["events", "clock", "header", "calibration"])
def test_a_stream_that_is_called_like_a_part_of_the_journal(tmp_path: Path, name: str) -> None:
    (problem,) = problems(tmp_path, TOML.replace("glove_right", name))
    assert f"devices.glove.streams.right: no stream can be called '{name}'" in problem


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('version = "1.0"', 'version = "2.0"', "this library knows"),
        ('format = "exumi-rig"', 'format = "rig"', "exumi-rig"),
        ("[rig]", "[rigg]", "this section is missing"),
        ('driver = "glove"', "", "the name of a driver"),
        ("streams = {", "stream = {", "the driver's ports"),
    ],
)
def test_what_a_rig_file_needs(tmp_path: Path, old: str, new: str, word: str) -> None:
    assert any(word in problem for problem in problems(tmp_path, TOML.replace(old, new)))


def test_no_devices(tmp_path: Path) -> None:
    text = TOML[: TOML.index("[devices")].replace('flag = "glove"', "")
    assert problems(tmp_path, text) == (
        "devices: at least one device is needed, as [devices.NAME]",
    )


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="exumi rig init"):
        load_rig(tmp_path / "none.toml")
    with pytest.raises(UsageError, match="not TOML"):
        load_rig(write(tmp_path, "a = = 3"))
    with pytest.raises(UsageError, match="not YAML"):
        load_rig(write(tmp_path, "a: [", "rig.yml"))
    with pytest.raises(UsageError, match="no tables"):
        load_rig(write(tmp_path, "- 3", "rig.yml"))
    with pytest.raises(UsageError, match="too many"):
        load_rig(write(tmp_path, "#" * (1 << 20) + "##"))


def test_files_that_would_never_end(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    for path in (tmp_path / "pipe.toml", Path("/dev/zero"), tmp_path):
        with pytest.raises(UsageError, match="is no file"):
            load_rig(path)
    with pytest.raises(UsageError, match="cannot be read"):
        load_rig(Path("a\0b.toml"))


@pytest.mark.parametrize("text", ["a = " + "[" * 100_000, "a = " + "1" * 5000])
def test_toml_that_python_cannot_hold(tmp_path: Path, text: str) -> None:
    with pytest.raises(UsageError, match="not TOML"):
        load_rig(write(tmp_path, text))


def test_yaml_that_says_things_twice(tmp_path: Path) -> None:
    text = YAML + "  glove: {driver: glove, rate_hz: 9, streams: {left: other, left: third}}\n"
    assert problems(tmp_path, text, "rig.yaml") == (
        "line 7, devices.glove: stands there twice",
        "line 7, devices.glove.streams.left: stands there twice",
    )


def test_mistakes_in_yaml_have_lines(tmp_path: Path) -> None:
    text = YAML.replace("rate_hz: 90", "rate_hz: fast")
    (problem,) = problems(tmp_path, text, "rig.yaml")
    assert problem.startswith("line 6, devices.glove.rate_hz: ")
    # Aliases that stand for a billion words, or for themselves, cost nothing.
    bomb = "a0: &a0 [x, x]\n" + "".join(
        f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12)
    )
    found = problems(tmp_path, bomb + "loop: &loop [*loop]\n" + YAML, "rig.yaml")
    assert len(found) == 13
    assert found[-1].startswith("line 13, loop: no such section")


@pytest.mark.parametrize("name", ["events", "clock", "calibration"])
def test_streams_that_a_journal_has_no_room_for(tmp_path: Path, name: str) -> None:
    (problem,) = problems(tmp_path, TOML.replace("glove_right", name))
    assert f"no stream can be called {name!r}" in problem


def test_a_wrong_device_hides_no_other_mistake(tmp_path: Path) -> None:
    text = TOML.replace("rate_hz = 90", 'rate_hz = "fast"').replace("glove_right", "glove_left")
    first, second = problems(tmp_path, text)
    assert "devices.glove.rate_hz" in first
    assert "the stream 'glove_left' is that of device 'glove' already" in second


@pytest.mark.parametrize(
    "line",
    [
        "reserve_mb = 99999999999999999999999",
        "queue_mb = 99999999",
        '[hooks]\nready = ["beep\\u0000"]',
        '[hooks]\nready = [""]',
    ],
)
def test_values_that_the_system_cannot_take(tmp_path: Path, line: str) -> None:
    text = TOML.replace("least_minutes = 5", line).replace('[hooks]\nstart = ["aplay"', '# ["', 1)
    assert len(problems(tmp_path, text)) == 1


def test_the_home_of_nobody(tmp_path: Path) -> None:
    text = TOML.replace('name = "exumi"', 'name = "exumi"\ndata = "~nobody-of-that-name/set"', 1)
    rig = load_rig(write(tmp_path, text))
    assert rig.beside(str(rig.about.data)) == tmp_path / "~nobody-of-that-name" / "set"
