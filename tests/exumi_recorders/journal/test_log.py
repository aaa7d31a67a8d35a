"""Logs: what was written comes back, whatever happened to the file."""

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_recorders.journal import reading
from exumi_recorders.journal.log import LogWriter, is_full, segment_name
from exumi_recorders.journal.reading import LogReader
from exumi_recorders.journal.record import (
    HEADER_BYTES,
    MAGIC,
    MAX_PAYLOAD_BYTES,
    NONE,
    checksum_of,
    pack_header,
    unpack_header,
)
from tests.exumi_recorders.journal.logs import SALT, pieces, read_log, record, write_log

INT64 = st.integers(-(1 << 63), (1 << 63) - 1)
PAYLOADS = st.lists(st.binary(max_size=80), max_size=12)


@given(
    seq=st.integers(0, (1 << 64) - 1),
    time_ns=INT64,
    device=INT64,
    sequence=INT64,
    flags=st.integers(0, (1 << 32) - 1),
    payload=st.binary(max_size=300),
)
def test_a_record_comes_back(
    seq: int, time_ns: int, device: int, sequence: int, flags: int, payload: bytes
) -> None:
    raw = pack_header(SALT, seq, time_ns, device, sequence, flags, payload)
    assert len(raw) == HEADER_BYTES
    header = unpack_header(raw)
    assert header is not None
    assert header[2:] == (seq, time_ns, device, sequence, flags)
    assert header.length == len(payload)
    assert header.checksum == checksum_of(SALT, raw, payload)
    assert header.checksum != checksum_of(SALT + 1, raw, payload)


def test_what_is_no_header_is_none() -> None:
    whole = record(1, b"abc")
    assert unpack_header(whole[: HEADER_BYTES - 1]) is None
    assert unpack_header(b"x" + whole[1:]) is None


@pytest.mark.parametrize("fixed", [None, 20])
def test_segments_are_filled_in_turn(tmp_path: Path, fixed: int | None) -> None:
    payloads = [bytes([number]) * 20 for number in range(100)]
    write_log(tmp_path / "log", payloads, segment_bytes=500)
    names = sorted(path.name for path in (tmp_path / "log").iterdir())
    assert names == [segment_name(number) for number in range(len(names))]
    assert len(names) > 10
    found, reader = read_log(tmp_path / "log", fixed)
    assert found == dict(enumerate(payloads))
    assert reader.damages == []
    assert reader.records == 100


def test_many_records_are_appended_at_once(tmp_path: Path) -> None:
    payloads = [bytes([number % 251]) * 7 for number in range(5000)]
    log = LogWriter(tmp_path / "log", segment_bytes=1 << 16)
    log.append(pieces(list(range(5000)), payloads))
    log.close()
    assert read_log(tmp_path / "log", 7)[0] == dict(enumerate(payloads))


@pytest.mark.parametrize("fixed", [None, 10])
def test_the_last_record_is_cut_at_every_byte(tmp_path: Path, fixed: int | None) -> None:
    payloads = [bytes([number]) * 10 for number in range(5)]
    write_log(tmp_path / "log", payloads)
    path = tmp_path / "log" / segment_name(0)
    whole = path.read_bytes()
    size = HEADER_BYTES + 10
    for length in range(len(whole) - size, len(whole)):
        path.write_bytes(whole[:length])
        found, reader = read_log(tmp_path / "log", fixed)
        assert found == dict(enumerate(payloads[:4]))
        rest = length - (len(whole) - size)
        reported = [(damage.path, damage.offset, damage.bytes) for damage in reader.damages]
        assert reported == ([(path, length - rest, rest)] if rest else [])


def test_a_tail_of_zeros_is_told_from_other_damage(tmp_path: Path) -> None:
    write_log(tmp_path / "log", [b"abc"])
    path = tmp_path / "log" / segment_name(0)
    path.write_bytes(path.read_bytes() + bytes(5000))
    found, reader = read_log(tmp_path / "log")
    assert found == {0: b"abc"}
    assert [(damage.what, damage.bytes) for damage in reader.damages] == [("zeros", 5000)]


@pytest.mark.parametrize("fixed", [None, 16])
def test_random_corruption_costs_only_what_it_hits(tmp_path: Path, fixed: int | None) -> None:
    rng = np.random.default_rng(7)
    payloads = [rng.bytes(16) for _ in range(200)]
    path = tmp_path / "log" / segment_name(0)
    write_log(tmp_path / "log", payloads)
    whole = path.read_bytes()
    size = HEADER_BYTES + 16
    for _ in range(60):
        spoilt = bytearray(whole)
        hit = set()
        for _ in range(rng.integers(1, 6)):
            start, length = int(rng.integers(len(whole))), int(rng.integers(1, 120))
            for at in range(start, min(start + length, len(whole))):
                spoilt[at] ^= int(rng.integers(1, 256))
                hit.add(at // size)
        path.write_bytes(spoilt)
        found, reader = read_log(tmp_path / "log", fixed)
        intact = {number: data for number, data in enumerate(payloads) if number not in hit}
        assert found == intact
        inside = [number for number in hit if number < max(intact)]
        assert sum(damage.lost or 0 for damage in reader.damages) == len(inside)
        assert sum(damage.bytes for damage in reader.damages) == size * len(hit)


@given(
    payloads=PAYLOADS, junk=st.lists(st.binary(max_size=60), max_size=13), cut=st.integers(0, 60)
)
def test_junk_between_records_is_passed_over(
    tmp_path_factory: pytest.TempPathFactory, payloads: list[bytes], junk: list[bytes], cut: int
) -> None:
    folder = tmp_path_factory.mktemp("log")
    raw = b""
    for number, payload in enumerate(payloads):
        raw += (junk[number] if number < len(junk) else b"") + record(number, payload)
    tail = record(len(payloads), b"cut")[:cut]
    (folder / segment_name(0)).write_bytes(raw + tail[: HEADER_BYTES + 2])
    found, _ = read_log(folder)
    assert found == dict(enumerate(payloads))


def test_bytes_may_be_missing_or_twice(tmp_path: Path) -> None:
    payloads = [bytes([number]) * 30 for number in range(6)]
    records = [record(number, payload) for number, payload in enumerate(payloads)]
    path = tmp_path / segment_name(0)
    path.write_bytes(records[0] + records[1][5:] + records[2] + records[2] + b"".join(records[3:]))
    found, reader = read_log(tmp_path)
    assert sorted(found) == [0, 2, 3, 4, 5]
    assert [damage.lost for damage in reader.damages] == [1, 0]


def test_a_record_within_a_payload_or_of_another_log_is_none(tmp_path: Path) -> None:
    other = record(7, b"other", salt=SALT ^ 1)
    outer = bytearray(record(1, b"<" + other + b">"))
    outer[HEADER_BYTES] ^= 1  # the outer one is spoilt: what lies in it is looked at
    path = tmp_path / segment_name(0)
    path.write_bytes(record(0, b"a") + bytes(outer) + other + record(9, b"z"))
    found, _ = read_log(tmp_path)
    assert found == {0: b"a", 9: b"z"}


def test_a_length_is_not_believed(tmp_path: Path) -> None:
    huge = bytearray(record(1, b"abc"))
    huge[4:8] = (MAX_PAYLOAD_BYTES + 1).to_bytes(4, "little")
    beyond = bytearray(record(2, b"abc"))
    beyond[4:8] = (1 << 20).to_bytes(4, "little")
    path = tmp_path / segment_name(0)
    path.write_bytes(record(0, b"a") + bytes(huge) + bytes(beyond) + record(3, b"d"))
    assert read_log(tmp_path)[0] == {0: b"a", 3: b"d"}


def test_a_file_of_magics_is_read_in_bounded_time(tmp_path: Path) -> None:
    liar = MAGIC + (30_000).to_bytes(4, "little") + bytes(4) + (5).to_bytes(8, "little") + bytes(28)
    path = tmp_path / segment_name(0)
    path.write_bytes(record(0, b"a") + liar * 2000)
    reader = LogReader(tmp_path, SALT)
    assert sum(len(block) for block in reader) == 1
    assert len(reader.damages) == 1


def test_records_of_another_log_are_passed_over_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a mistake with files: each of many records begins like one of this log."""
    write_log(tmp_path / "log", [b"ab"])
    strange = b"".join(record(number, b"ab", salt=SALT + 1) for number in range(1, 30_000))
    path = tmp_path / "log" / segment_name(0)
    path.write_bytes(path.read_bytes() + strange)
    seen, real = 0, reading._Segment.read

    def read(self: reading._Segment, offset: int, length: int) -> bytes:
        nonlocal seen
        found = real(self, offset, length)
        seen += len(found)
        return found

    monkeypatch.setattr(reading._Segment, "read", read)
    found, reader = read_log(tmp_path / "log")
    assert list(found) == [0]
    assert [damage.bytes for damage in reader.damages] == [len(strange)]
    assert seen < 8 * len(strange)


def test_a_missing_segment_and_a_missing_log_are_told(tmp_path: Path) -> None:
    payloads = [bytes([number]) * 20 for number in range(30)]
    write_log(tmp_path / "log", payloads, segment_bytes=300)
    (tmp_path / "log" / segment_name(1)).unlink()
    found, reader = read_log(tmp_path / "log", 20)
    assert reader.damages[0].path.name == segment_name(1)
    assert reader.damages[0].lost == 30 - len(found) > 0
    gone = LogReader(tmp_path / "nothing", SALT)
    assert list(gone) == []
    assert gone.damages[0].what == "the log is not there"


def test_links_and_foreign_files_are_not_read(tmp_path: Path) -> None:
    write_log(tmp_path / "log", [b"a"])
    (tmp_path / "other").write_bytes(record(1, b"b"))
    (tmp_path / "log" / segment_name(1)).symlink_to(tmp_path / "other")
    (tmp_path / "log" / "notes.txt").write_bytes(record(2, b"c"))
    assert read_log(tmp_path / "log")[0] == {0: b"a"}


def test_holes_in_the_numbers_are_no_damage(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log")
    log.append(pieces([0, 1, 5], [b"a", b"b", b"f"]))
    log.close()
    found, reader = read_log(tmp_path / "log")
    assert found == {0: b"a", 1: b"b", 5: b"f"}
    assert reader.damages == []


def test_a_full_disk_leaves_whole_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = LogWriter(tmp_path / "log")
    log.append(pieces([0], [b"a" * 50]))
    room = 2 * (HEADER_BYTES + 50) + 30
    written = 0

    def writev(descriptor: int, given: list[bytes]) -> int:
        nonlocal written
        return_value = os.write(descriptor, b"".join(given)[:room])
        written += return_value
        return return_value

    def write(descriptor: int, data: memoryview) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "writev", writev)
    with monkeypatch.context() as patch:
        real = os.write
        patch.setattr(os, "write", lambda fd, data: write(fd, data) if written else real(fd, data))
        with pytest.raises(OSError, match="No space") as caught:
            log.append(pieces([1, 2, 3], [b"b" * 50, b"c" * 50, b"d" * 50]))
    assert is_full(caught.value)
    monkeypatch.undo()
    log.append(pieces([4], [b"e" * 50]))  # there is room again
    log.close()
    found, reader = read_log(tmp_path / "log")
    assert sorted(found) == [0, 1, 2, 4]
    assert reader.damages == []
    assert log.bytes == 4 * (HEADER_BYTES + 50)


LIMITED = """
import resource, sys
from pathlib import Path
from exumi_recorders.journal.log import LogWriter, is_full
from tests.exumi_recorders.journal.logs import pieces
log = LogWriter(Path(sys.argv[1]))
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, resource.RLIM_INFINITY))
try:
    for number in range(1000):
        log.append(pieces([number], [bytes(90)]))
except OSError as error:
    print(is_full(error), number)
log.close()
"""


def test_a_limit_of_the_system_leaves_whole_records(tmp_path: Path) -> None:
    command = [sys.executable, "-c", LIMITED, str(tmp_path / "log")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path.cwd())
    full, number = done.stdout.split()
    assert full == "True"
    found, reader = read_log(tmp_path / "log", 90)
    assert len(found) == int(number) == 10_000 // (HEADER_BYTES + 90)
    assert reader.damages == []
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def test_what_is_flushed_is_told(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log", segment_bytes=100)
    assert log.flush() == []
    log.append(pieces([0], [bytes(200)]))
    size = HEADER_BYTES + 200
    assert log.flush() == [(tmp_path / "log" / segment_name(0), size)]
    log.append(pieces([1], [bytes(200)]))
    log.append(pieces([2], [bytes(200)]))
    told = [(path.name, length) for path, length in log.close()]
    assert told == [(segment_name(1), size), (segment_name(2), size)]
    assert log.close() == []
    with pytest.raises(OSError, match="the log is closed"):
        log.append(pieces([3], [b""]))


def test_none_is_no_time() -> None:
    header = unpack_header(pack_header(SALT, 0, 0, NONE, NONE, 0, b""))
    assert header is not None
    assert header.time_device == header.sequence == NONE
