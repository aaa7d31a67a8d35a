"""Logs written and read back in tests."""

from pathlib import Path

from exumi_recorders.journal.log import LogWriter
from exumi_recorders.journal.reading import LogReader
from exumi_recorders.journal.record import NONE, pack_header, salt_of

SALT = salt_of("an episode", "a log")


def record(number: int, payload: bytes, *, salt: int = SALT, time_ns: int | None = None) -> bytes:
    at = number * 1000 if time_ns is None else time_ns
    return pack_header(salt, number, at, NONE, number, 0, payload) + payload


def pieces(numbers: list[int], payloads: list[bytes]) -> list[bytes]:
    found = []
    for number, payload in zip(numbers, payloads, strict=True):
        whole = record(number, payload)
        found += [whole[: len(whole) - len(payload)], payload]
    return found


def write_log(folder: Path, payloads: list[bytes], *, segment_bytes: int = 1 << 20) -> None:
    log = LogWriter(folder, segment_bytes=segment_bytes)
    for number, payload in enumerate(payloads):
        log.append(pieces([number], [payload]))
    log.close()


def read_log(folder: Path, fixed: int | None = None) -> tuple[dict[int, bytes], LogReader]:
    """Return payloads by number, and the reader with what it found wrong."""
    reader = LogReader(folder, SALT, fixed)
    found: dict[int, bytes] = {}
    for block in reader:
        rows = block.files if block.rows is None else [row.tobytes() for row in block.rows]
        found.update(zip(block.seq.tolist(), rows, strict=True))
        assert block.time_host.tolist() == [1000 * number for number in block.seq.tolist()]
        assert block.sequence.tolist() == block.seq.tolist()
        assert len(block.damaged) == len(block.flags) == len(rows)
    return found, reader
