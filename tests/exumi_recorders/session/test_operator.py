"""What is said to the operator never holds up the session: nobody has to read it, or be there."""

import fcntl
import io
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest

from exumi_recorders.recording.status import (
    DeviceStatus,
    Problem,
    RecordingStatus,
    StreamStatus,
)
from exumi_recorders.session.messages import Message, SessionStatus
from exumi_recorders.session.operator import Operator, age_text
from exumi_recorders.session.session import Session
from exumi_recorders.session.terminal import draw_status, status_document

STREAMS = (
    StreamStatus(
        name="pose",
        device="headset",
        kind="pose",
        rate_hz=89.98,
        jitter_s=0.0003,
        age_s=0.011,
        samples=1234,
    ),
    StreamStatus(
        name="tactile_left",
        device="left",
        kind="tactile",
        age_s=1.5,
        samples=400,
        dropped=2,
        lost={"sequence": 3},
        queue_bytes=160_000,
    ),
    StreamStatus(name="opening", device="encoder", kind="width", rate_hz=500.0, age_s=0.002),
)
RECORDING = RecordingStatus(
    recording=True,
    episode="x",
    elapsed_s=13.7,
    bytes=42_000_000,
    pressure=0.0,
    truncated=None,
    free_bytes=1 << 40,
    streams=STREAMS,
    devices=(
        DeviceStatus(name="headset", connected=True, readings={"dialect": "b"}),
        DeviceStatus(name="encoder", connected=True, readings={"magnet": True, "agc": 64}),
        DeviceStatus(name="left", connected=False),
    ),
    problems=(Problem("left", "device_lost", "left is gone: [unplugged]."),),
)
STATUS = SessionStatus(
    state="recording",
    recording=RECORDING,
    kept=3,
    discarded=1,
    finishing=1,
    undecided=False,
    disk_minutes=42.4,
    next_trial=4,
    widths_m={"opening": 0.0423},
)


def test_all_that_the_operator_has_to_see() -> None:
    from rich.console import Console

    console = Console(record=True, width=100, file=io.StringIO())
    console.print(draw_status(STATUS, sync=age_text(7200), preview="http://127.0.0.1:8642/"))
    lines = console.export_text().splitlines()
    assert "REC" in lines[0]
    assert "13.7 s  42 MB   3 kept, 1 discarded, 1 being finished · trial 4" in lines[0]
    rows = {line.split()[0]: line.split() for line in lines[2:6]}
    assert rows["pose"] == ["pose", "90.0", "0.30", "11", "0", "1,234", "0"]
    assert rows["tactile_left"] == ["tactile_left", "-", "-", "1500", "160", "400", "5"]
    assert lines[1] == "! left: left is gone: [unplugged]."
    rest = "\n".join(lines[6:])
    assert "encoder: magnet True, agc 64, width 42.3 mm" in rest
    assert "left: not connected" in rest
    assert "disk 42 min · sync 2 h old · http://127.0.0.1:8642/" in rest
    assert "d discard" in rest


def drawn(width: int, height: int) -> list[str]:
    from rich.console import Console

    console = Console(record=True, width=width, file=io.StringIO())
    console.print(
        draw_status(
            STATUS, sync="2 h old", preview="http://127.0.0.1:8642/", width=width, height=height
        )
    )
    return console.export_text().splitlines()


@pytest.mark.parametrize("width", [20, 40, 60, 80, 200])
@pytest.mark.parametrize("height", [1, 3, 5, 8, 12, 60])
def test_it_fits_every_terminal(width: int, height: int) -> None:
    lines = drawn(width, height)
    assert len(lines) <= max(height - 1, 2)
    assert max(map(len, lines)) <= width
    assert "REC" in lines[0]
    assert lines[1].startswith("! left: left")


def test_what_there_is_no_room_for_is_left_out() -> None:
    narrow = drawn(40, 24)
    assert narrow[2].split() == ["stream", "Hz", "age", "ms", "lost"]
    assert narrow[4].split() == ["tactile_left", "-", "1500", "5"]
    short = drawn(100, 8)
    assert [line.split()[0] for line in short[2:]] == [
        "stream",
        "pose",
        "tactile_left",
        "opening",
        "disk",
    ]


@pytest.mark.parametrize(
    ("age_s", "text"),
    [(None, "not calibrated"), (90.0, "2 min old"), (7200.0, "2 h old"), (4e5, "5 days old")],
)
def test_ages(age_s: float | None, text: str) -> None:
    assert age_text(age_s) == text


def say_much(operator: Operator) -> float:
    """Say more than fits; return how long that took."""
    began = time.monotonic()
    with operator:
        for number in range(5000):
            operator.tell(Message("info", "much", f"{number}: {'x' * 100}"))
            operator.show(STATUS)
        operator.end({"type": "report"}, "the end")
    return time.monotonic() - began


@pytest.mark.parametrize("as_json", [True, False])
def test_nobody_reads(as_json: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    with os.fdopen(writer, "w") as full:
        monkeypatch.setattr(sys, "stdout" if as_json else "stderr", full)
        assert say_much(Operator(as_json=as_json)) < 4.0
        monkeypatch.undo()
        os.close(reader)


@pytest.mark.parametrize("as_json", [True, False])
def test_nobody_is_there(as_json: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as broken:
        monkeypatch.setattr(sys, "stdout" if as_json else "stderr", broken)
        assert say_much(Operator(as_json=as_json)) < 2.0
        monkeypatch.undo()


def test_a_reading_that_is_no_number_does_not_end_the_stream() -> None:
    device = DeviceStatus(name="d", connected=True, readings={"gain": float("nan"), "agc": 3})
    status = replace(STATUS, recording=replace(RECORDING, devices=(device,)))
    document = status_document(status, sync_age_s=None)
    assert document["devices"][0]["readings"] == {"gain": None, "agc": 3}
    json.dumps(document, allow_nan=False)


def test_everything_is_said_to_who_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "said"
    with path.open("w", encoding="utf-8") as file:
        monkeypatch.setattr(sys, "stdout", file)
        with Operator(as_json=True) as operator:
            operator.tell(Message("warning", "odd", 'a "quoted" [bold] \n text é', "id"))
            operator.show(STATUS)
            operator.end({"type": "report", "episodes": []}, "")
        monkeypatch.undo()
    said = [json.loads(line) for line in path.read_text().splitlines()]
    assert said[0]["text"] == 'a "quoted" [bold] \n text é'
    assert said[-1] == {"type": "report", "episodes": []}


def test_the_age_of_the_calibration_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    operator = Operator(keys=False)
    now = time.monotonic()
    operator.attend(cast(Session, None), sync_age_s=60.0, preview=None)
    assert operator.sync_age_s == pytest.approx(60.0, abs=1.0)
    monkeypatch.setattr(time, "monotonic", lambda: now + 3600)
    assert operator.sync_age_s == pytest.approx(3660.0, abs=1.0)
