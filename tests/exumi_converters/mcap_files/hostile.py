"""MCAP files as nobody should write them."""

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"
Change = Callable[[Any], Any]


def rewrite(source: Path, target: Path, change: Change) -> Path:
    """Write a file again, each record as `change` returns it; None leaves it out."""
    target.parent.mkdir(parents=True, exist_ok=True)
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    with source.open("rb") as old, target.open("wb") as new:
        writer = Writer(new, compression=CompressionType.NONE)
        writer.start()
        for record in StreamReader(old).records:
            changed = change(record)
            if isinstance(changed, Schema) and changed.id not in schemas:
                schemas[changed.id] = writer.register_schema(
                    changed.name, changed.encoding, changed.data
                )
            elif isinstance(changed, Channel) and changed.id not in channels:
                channels[changed.id] = writer.register_channel(
                    changed.topic,
                    changed.message_encoding,
                    schemas[changed.schema_id],
                    changed.metadata,
                )
            elif isinstance(changed, Message):
                writer.add_message(
                    channels.get(changed.channel_id, changed.channel_id),
                    changed.log_time,
                    changed.data,
                    changed.publish_time,
                )
            elif isinstance(changed, Metadata):
                writer.add_metadata(changed.name, changed.metadata)
            elif isinstance(changed, Attachment):
                writer.add_attachment(0, 0, changed.name, changed.media_type, changed.data)
        writer.finish()  # type: ignore[no-untyped-call]  # the library types most of itself
    return target


def messages(topic: str, change: Callable[[Any], Any]) -> Change:
    """Return a change of the messages of one topic."""
    numbers: set[int] = set()

    def changed(record: Any) -> Any:
        if isinstance(record, Channel) and record.topic == topic:
            numbers.add(record.id)
        is_one = isinstance(record, Message) and record.channel_id in numbers
        return change(record) if is_one else record

    return changed


def attachments(part: str, data: bytes | None) -> Change:
    """Return a change of the attachments whose names hold a text; None leaves them out."""

    def changed(record: Any) -> Any:
        if isinstance(record, Attachment) and part in record.name:
            if data is None:
                return None
            record.data = data
        return record

    return changed


def npy(header: str, data: bytes = b"") -> bytes:
    """Return an ``.npy`` file with a header of one's own."""
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    """Return a record, with whatever length it claims."""
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def attachment(name: bytes, size: int) -> bytes:
    """Return the beginning of an attachment of many bytes, which the caller writes."""
    head = bytes(16) + struct.pack("<I", len(name)) + name + struct.pack("<IQ", 0, size)
    return record(0x09, head, len(head) + size + 4)


def chunk(data: bytes, size: int, compression: bytes = b"") -> bytes:
    """Return a chunk that claims a size."""
    head = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression
    return record(0x06, head + struct.pack("<Q", len(data)) + data)


def header() -> bytes:
    """Return how a file begins."""
    file = io.BytesIO()
    Writer(file).start()
    return file.getvalue()
