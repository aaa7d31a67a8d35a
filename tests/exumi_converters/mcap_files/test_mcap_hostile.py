"""MCAP files that lie, bombs, and what one of ours says when it was tampered with."""

import os
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.records import Message

from exumi_converters import ConversionReport, ConvertOptions, ExportOptions, convert, export
from exumi_converters.mcap_files import writing
from exumi_converters.mcap_files.records import Records
from exumi_converters.registry import find_converter, find_exporter
from exumi_converters.testing import round_trip_differences
from exumi_data import EpisodeWriter
from exumi_data.catalog import build_catalog, write_catalog
from exumi_data.dataset import open_dataset
from exumi_data.errors import SourceError
from exumi_data.model import Clock
from tests.exumi_converters.mcap_files.hostile import (
    MAGIC,
    attachment,
    attachments,
    chunk,
    header,
    messages,
    npy,
    record,
    rewrite,
)
from tests.exumi_converters.whole import Made, metadata_of, write_dataset

QUICK = ConvertOptions(workers=1, durable=False)
MIB = 1 << 20
NPY = "{{'descr': '{}', 'fortran_order': False, 'shape': ({},)}}"


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write_dataset(tmp_path_factory.mktemp("ours") / "data", 1, seconds=0.2)
    path = root.parent / "ours.mcap"
    export(root, path, to_format="mcap", options=ExportOptions(workers=1, durable=False))
    return path


def read(path: Path) -> ConversionReport:
    return convert(path, path.parent / "read", from_format="mcap", options=QUICK)


def with_data(data: bytes) -> Any:
    def change(message: Message) -> Message:
        message.data = data
        return message

    return change


def at(time_ns: int) -> Any:
    def change(message: Message) -> Message:
        message.log_time = time_ns
        return message

    return change


def of_channel(number: int) -> Any:
    def change(message: Message) -> Message:
        message.channel_id = number
        return message

    return change


def every_second() -> Any:
    count = iter(range(10**6))
    return lambda message: message if next(count) % 2 else None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (messages("/pose", with_data(b"\xff" * 30)), "/pose is not what its schema says"),
        (messages("/mic", with_data(b"")), "/mic is not what its schema says"),
        (messages("/width", with_data(b"{}")), "'width' holds no width_m"),
        (messages("/width", with_data(b"[" * 100_000)), "/width is no JSON object"),
        (messages("/width", at(2**64 - 1)), "holds no int64"),
        (messages("/tactile/sample", every_second()), "/tactile/sample"),
        (messages("/tactile/sample", of_channel(999)), "/tactile/sample lacks what stands beside"),
        (messages("/tactile", every_second()), "/tactile/sample belongs to no sample"),
        (
            attachments(
                "reference",
                npy(NPY.format("|u1", 2**60)),
            ),
            "is no plain array ((1152921504606846976,) of uint8 is not 0 bytes)",
        ),
        (
            attachments(
                "reference",
                npy(NPY.format("|O", 1), b"cos\nsystem\n"),
            ),
            "is no plain array (it holds object)",
        ),
        (attachments("reference", npy("{'descr': '<f8', (((((")), "is no plain array"),
        (attachments("reference", b"PK\x03\x04" + bytes(40)), "is no plain array"),
    ],
)
def test_what_was_tampered_with_is_told(
    ours: Path, tmp_path: Path, change: Any, reason: str
) -> None:
    report = read(rewrite(ours, tmp_path / "x.mcap", change))
    assert [reason in failure.reason for failure in report.failed] == [True], report.failed
    assert "defect" not in report.failed[0].reason
    assert not list((tmp_path / "read").glob("episodes/*/*"))


def test_what_is_not_attached_any_more_is_told_and_the_rest_is_kept(
    ours: Path, tmp_path: Path
) -> None:
    report = read(rewrite(ours, tmp_path / "x.mcap", attachments("exumi/arrays", None)))
    assert not report.failed
    assert open_dataset(tmp_path / "read")[0]["tactile"].reference is None


@pytest.mark.parametrize("name", ["sample", "calibration", "reference"])
def test_a_stream_may_bear_the_name_of_a_topic_of_ours(tmp_path: Path, name: str) -> None:
    root = write_dataset(tmp_path / "data", 1, seconds=0.1)
    path = Path(open_dataset(root)[0].path)
    with EpisodeWriter(path, metadata_of(Made()), durable=False, overwrite=True) as writer:
        clock = Clock(source="hub", stamp_point="user_rx")
        width = writer.add_stream(name, kind="width", clock=clock)
        time = np.arange(4) * 10**7
        width.append(time, np.array([0.1, 0.2, np.nan, 0.3], np.float32), time_host=time + 5)
    write_catalog(root, build_catalog(root)[0])
    lost = round_trip_differences(
        find_exporter("mcap"), find_converter("mcap"), root, tmp_path / "trip"
    )
    assert lost == {"identity", "source"}


def test_large_videos_are_attached_in_pieces(
    make_clip: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_clip(tmp_path / "clips" / "a.mp4", 12)
    convert(tmp_path / "clips", tmp_path / "data", from_format="clips", options=QUICK)
    monkeypatch.setattr(writing, "_PIECE_BYTES", 1000)
    told = ExportOptions(workers=1, durable=False, settings={"video": "attach"})
    lost = round_trip_differences(
        find_exporter("mcap"),
        find_converter("mcap"),
        tmp_path / "data",
        tmp_path / "trip",
        export_options=told,
        convert_options=QUICK,
    )
    assert lost == {"identity", "source"}
    # One that lacks a piece is refused.
    (whole,) = (tmp_path / "trip" / "out").glob("*.mcap")
    report = read(rewrite(whole, tmp_path / "cut" / "x.mcap", attachments(".000001", None)))
    assert "bytes, its metadata says" in report.failed[0].reason


def test_attachments_are_not_read_into_memory(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        file.write(header() + attachment(b"a film", 64 * MIB))
        file.seek(64 * MIB, 1)  # a hole
        file.write(bytes(4) + record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC)
    tracemalloc.start()
    try:
        report = read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "no message of it can be read: it is empty" in report.failed[0].reason
    assert peak < 32 * MIB


def test_a_damaged_attachment_is_told(ours: Path, tmp_path: Path) -> None:
    raw = bytearray(ours.read_bytes())
    raw[raw.index(b"reference.npy") + 700] ^= 1
    path = tmp_path / "x.mcap"
    path.write_bytes(bytes(raw))
    assert "reference.npy is damaged" in read(path).failed[0].reason


@pytest.mark.parametrize(
    ("bomb", "damage"),
    [
        (record(0x05, b"", 2**60), "a record claims 1,152,921,504,606,846,976 bytes, 0 are left"),
        (record(0x09, b"x" * 60), "EndOfFile"),
        (attachment(b"", 2**60), "a record claims 1,152,921,504,606,847,012 bytes"),
        (record(0x09, attachment(b"", 2**60)[9:] + bytes(60)), "the attachment '' claims 1,152,"),
        (chunk(b"x" * 40, 10, b"brotli"), "compressed as 'brotli', which is not read"),
        (chunk(b"x" * 40, 10, b"zstd"), "a chunk cannot be decompressed"),
        (chunk(zstandard.compress(bytes(99)), 10, b"zstd"), "claims 10 bytes, and has not as many"),
        (chunk(record(0x05, b"", 2**60), 9), "a record of a chunk claims"),
        (chunk(record(0x05, b"xx"), 11), "a message is cut short"),
    ],
)
def test_records_that_lie_end_the_reading(tmp_path: Path, bomb: bytes, damage: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(header() + bomb)
    records = Records(path)
    assert list(records.read()) == []
    assert damage in str(records.damage)


def test_millions_of_empty_messages_do_not_fill_the_memory(tmp_path: Path) -> None:
    many = record(0x05, struct.pack("<HIQQ", 1, 0, 0, 0)) * 20_000
    path = tmp_path / "x.mcap"
    path.write_bytes(header() + chunk(zstandard.compress(many), len(many), b"zstd"))
    tracemalloc.start()
    try:
        count = sum(1 for _ in Records(path).read())
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert count == 20_000
    assert peak < 3 * len(many)


@pytest.mark.parametrize("name", ["a\nb.mcap", " x.mcap", "b\udcff.mcap", "d/" * 130 + "x.mcap"])
def test_names_that_cannot_be_recorded_are_told(ours: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / "in" / name
    path.parent.mkdir(parents=True)
    path.write_bytes(ours.read_bytes())
    report = convert(tmp_path / "in", tmp_path / "read", from_format="mcap", options=QUICK)
    assert "its name cannot be recorded" in report.failed[0].reason
    assert report.failed[0].reason.isprintable()


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.mcap")
    assert find_converter("mcap").recognise(tmp_path) is None
    with pytest.raises(SourceError, match=r"no \.mcap file"):
        convert(tmp_path, tmp_path / "read", from_format="mcap", options=QUICK)
