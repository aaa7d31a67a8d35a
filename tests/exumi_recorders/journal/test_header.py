"""``header.json``: ports and metadata are written down, and read back as they were."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from exumi_data.errors import MetadataError, UnsupportedError, UsageError
from exumi_data.model import Frames, RawData, Sensor
from exumi_recorders.contract import Blocks, Files, Port, Rows
from exumi_recorders.journal.header import (
    JournalHeader,
    KnownLatency,
    StreamHeader,
    parse_header,
    port_document,
    port_of,
)
from tests.exumi_recorders.numbered import CAMERA, POSE, episode, port

FULL = Port(
    name="pose",
    kind="pose",
    payload=Rows({"raw": ("<f4", (7,))}),
    stamp_point="kernel_rx",
    nominal_rate="72",
    transform="world_frame",
    modulus=65536,
    time_device_unit="ns",
    sensor=Sensor(model="quest-3", serial="1"),
    lossy="nothing",
    metadata={
        "frames": Frames(parent="world", child="controller"),
        "raw": RawData(unit="m", reference_frame="headset"),
        "acme:note": {"a": (1, 2)},
    },
)


def header(**streams: Port) -> JournalHeader:
    return JournalHeader(
        boot_id="b",
        t0_monotonic_ns=5,
        episode=episode(),
        streams={
            name: StreamHeader(device="d", port=port_document(each))
            for name, each in streams.items()
        },
    )


@pytest.mark.parametrize(
    "given",
    [
        FULL,
        CAMERA,
        Port(name="sound", kind="audio", payload=Blocks(2, "48000"), stamp_point="user_rx"),
        Port(
            name="taxels",
            kind="taxels",
            payload=Rows({"data": ("<i2", (2, 3)), "raw": ("<u2", (6,))}),
            stamp_point="user_rx",
            valid=((True, False, True), (True, True, True)),
            droppable=True,
            metadata={"grid": [2, 3], "unit": "adc"},
        ),
    ],
)
def test_a_port_comes_back(given: Port) -> None:
    whole = header(a_stream=given)
    read = parse_header(whole.to_json(), Path("header.json"))
    assert read == whole
    found = port_of(read.streams["a_stream"].port)
    assert found.payload == given.payload
    for field in ("name", "kind", "stamp_point", "nominal_rate", "transform", "droppable"):
        assert getattr(found, field) == getattr(given, field)
    for field in ("modulus", "time_device_unit", "sensor", "valid", "lossy"):
        assert getattr(found, field) == getattr(given, field)
    assert port_document(found) == port_document(given)


def test_metadata_of_a_port_becomes_json() -> None:
    document = port_document(FULL).metadata
    assert document == {
        "frames": {"parent": "world", "child": "controller"},
        "raw": {"unit": "m", "reference_frame": "headset"},
        "acme:note": {"a": [1, 2]},
    }


@pytest.mark.parametrize(
    "wrong",
    [
        {"payload": Rows({"data": (">f8", (7,))})},
        {"payload": Rows({"data": ("<c16", (7,))})},
        {"payload": Rows({"data": ("nonsense", (7,))})},
        {"payload": Rows({"data": ("<f8", (7000, 7000))})},
        {"payload": Rows({"other": ("<f8", (7,))})},
        {"payload": Rows({})},
        {"payload": Files(0, 10, 3)},
        {"nominal_rate": "29.97"},
        {"metadata": {"frames": object()}},
    ],
)
def test_a_port_that_cannot_be_recorded_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="port 'pose' cannot be recorded"):
        port_document(port(POSE, **wrong))


@pytest.mark.parametrize("name", ["events", "clock", "header", "calibration", "../up", "Upper", ""])
def test_streams_have_names_that_are_folders_of_their_own(name: str) -> None:
    with pytest.raises(ValidationError):
        header(**{name: POSE})


def test_a_stream_without_measured_times_is_refused() -> None:
    with pytest.raises(ValidationError, match="nothing but its rate"):
        header(pose=port(POSE, stamp_point="nominal_rate"))


def test_a_latency_is_kept() -> None:
    whole = header(pose=POSE)
    whole.streams["pose"].latency = KnownLatency(latency_ns=7, latency_sigma_ns=2.0, method="sweep")
    assert parse_header(whole.to_json(), Path("h")).streams["pose"].latency.method == "sweep"


def test_a_header_of_another_kind_is_refused() -> None:
    document = json.loads(header(pose=POSE).to_json())
    with pytest.raises(MetadataError, match="expected format"):
        parse_header(json.dumps({**document, "format": "exumi-episode"}).encode(), Path("h"))
    with pytest.raises(UnsupportedError, match="newer"):
        parse_header(json.dumps({**document, "version": "2.0"}).encode(), Path("h"))
    with pytest.raises(MetadataError, match="t0_monotonic_ns"):
        parse_header(json.dumps({**document, "t0_monotonic_ns": 1.5}).encode(), Path("h"))
    with pytest.raises(MetadataError, match="unknown key"):
        parse_header(json.dumps({**document, "extra": 1}).encode(), Path("h"))
