"""The records of an MCAP file in its order: bounded whatever it claims, and up to damage."""

import io
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from exumi_data.errors import LimitError, SourceError

__all__ = ["AttachedFile", "Records"]

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_RECORD_BYTES = 256 * 1024**2
_CHUNK_BYTES = 256 * 1024**2
_ATTACHMENT_HEAD_BYTES = 64 * 1024
_PIECE = 1 << 20
_LEAST_MESSAGE = 22  # bytes before its data


@dataclass(frozen=True, slots=True)
class AttachedFile:
    """A file that is attached: where its bytes lie. They are read when they are asked for.

    Attributes
    ----------
    path : pathlib.Path
        The MCAP file.
    name : str
    start, size : int
        Where its bytes begin, and how many there are.
    head_crc, crc : int
        Checksums of what stands before them in the record, and of both; 0: there is none.
    """

    path: Path
    name: str
    start: int
    size: int
    head_crc: int
    crc: int

    def pieces(self) -> Iterator[bytes]:
        """Yield its bytes, a mebibyte at a time.

        Raises
        ------
        SourceError
            They are not those that were attached.
        """
        left, crc = self.size, self.head_crc
        with self.path.open("rb") as file:
            file.seek(self.start)
            while left:
                piece = file.read(min(left, _PIECE))
                if not piece:
                    raise SourceError("changed while it was read", where=self.path)
                left -= len(piece)
                crc = zlib.crc32(piece, crc)
                yield piece
        if self.crc not in (0, crc):
            raise SourceError(f"the attachment {self.name} is damaged", where=self.path)

    def read(self) -> bytes:
        """Return its bytes.

        Raises
        ------
        LimitError
            There are more than 256 MiB.
        SourceError
            They are not those that were attached.
        """
        if self.size > _RECORD_BYTES:
            raise LimitError(
                f"the attachment {self.name} has more than {_RECORD_BYTES >> 20} MiB",
                where=self.path,
            )
        return b"".join(self.pieces())


@dataclass(slots=True)
class Records:
    """The records of one file.

    Attributes
    ----------
    path : pathlib.Path
    damage : str or None
        Why reading ended before the file did; known when `read` has ended.
    """

    path: Path
    damage: str | None = field(default=None, init=False)

    def read(self) -> Iterator[Any]:
        """Yield schemas, channels, messages and metadata of the library, and attached files.

        Those within chunks come in their order; those of the summary too. What the file's indexes
        say plays no part.

        Raises
        ------
        LimitError
            A chunk or a record holds more than 256 MiB.
        """
        from mcap.exceptions import McapError

        with self.path.open("rb") as file:
            try:
                yield from self._records(file)
            except (McapError, struct.error, ValueError, EOFError) as error:
                self.damage = str(error) or type(error).__name__

    def _records(self, file: IO[bytes]) -> Iterator[Any]:
        from mcap.opcode import Opcode
        from mcap.records import Channel, Chunk, Metadata, Schema

        readers: dict[int, Any] = {
            Opcode.SCHEMA: Schema,
            Opcode.CHANNEL: Channel,
            Opcode.METADATA: Metadata,
            Opcode.CHUNK: Chunk,
        }
        if file.read(len(_MAGIC)) != _MAGIC:
            msg = "it begins as no MCAP file does"
            raise ValueError(msg)
        end = os.fstat(file.fileno()).st_size
        opcode = 0
        while opcode != Opcode.FOOTER:
            opcode, length = _head(file)
            start = file.tell()
            if length > end - start:
                msg = f"a record claims {length:,} bytes, {end - start:,} are left"
                raise ValueError(msg)
            if opcode == Opcode.ATTACHMENT:
                yield self._attached(file, start, length)
            elif opcode == Opcode.MESSAGE:
                yield _message(self._content(file, length))
            elif opcode in readers:
                record = readers[opcode].read(_stream(self._content(file, length)))
                if opcode == Opcode.CHUNK:
                    yield from _of_chunk(self._inflated(record))
                else:
                    yield record
            file.seek(start + length)
        if file.read(len(_MAGIC)) != _MAGIC:
            msg = "it ends as no MCAP file does"
            raise ValueError(msg)

    def _content(self, file: IO[bytes], length: int) -> bytes:
        if length > _RECORD_BYTES:
            raise self._too_much("record", _RECORD_BYTES)
        return file.read(length)

    def _attached(self, file: IO[bytes], start: int, length: int) -> AttachedFile:
        head = io.BytesIO(file.read(min(length, _ATTACHMENT_HEAD_BYTES)))
        stream = _stream(head)
        stream.read(16)  # when it was logged and made
        name = stream.read_prefixed_string()
        stream.read_prefixed_string()  # its media type
        size = stream.read8()
        before = head.tell()
        if before + size + 4 != length:
            msg = f"the attachment {name!r} claims {size:,} bytes, its record has {length:,}"
            raise ValueError(msg)
        file.seek(start + length - 4)
        (crc,) = struct.unpack("<I", file.read(4))
        head_crc = zlib.crc32(head.getbuffer()[:before])
        return AttachedFile(self.path, name, start + before, size, head_crc, crc)

    def _inflated(self, chunk: Any) -> bytes:
        """Decompress a chunk without trusting what it says of its size."""
        if chunk.uncompressed_size > _CHUNK_BYTES:
            raise self._too_much("chunk", _CHUNK_BYTES)
        if chunk.compression == "zstd":
            data = _read(_zstd_reader(chunk.data), chunk.uncompressed_size)
        elif chunk.compression == "lz4":
            data = _read(_lz4_reader(chunk.data), chunk.uncompressed_size)
        elif not chunk.compression:
            data = chunk.data
        else:
            msg = f"a chunk is compressed as {chunk.compression!r}, which is not read"
            raise ValueError(msg)
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            msg = "a chunk is not what its checksum says"
            raise ValueError(msg)
        return data

    def _too_much(self, what: str, limit: int) -> LimitError:
        return LimitError(
            f"a {what} holds more than {limit >> 20} MiB",
            where=self.path,
            fix="Write the file again in smaller chunks: mcap compress --chunk-size",
        )


def _head(file: IO[bytes]) -> tuple[int, int]:
    """Return opcode and length of the next record."""
    raw = file.read(_HEAD.size)
    if len(raw) < _HEAD.size:
        msg = "it ends in the middle"
        raise EOFError(msg)
    opcode, length = _HEAD.unpack(raw)
    return opcode, length


def _stream(content: bytes | IO[bytes]) -> Any:
    from mcap.data_stream import ReadDataStream

    return ReadDataStream(io.BytesIO(content) if isinstance(content, bytes) else content)


def _message(content: bytes) -> Any:
    from mcap.records import Message

    if len(content) < _LEAST_MESSAGE:
        msg = "a message is cut short"
        raise ValueError(msg)
    return Message.read(_stream(content), len(content))


def _of_chunk(data: bytes) -> Iterator[Any]:
    """Yield a chunk's records one by one: of empty ones, millions fit into it."""
    from mcap.opcode import Opcode
    from mcap.records import Channel, Schema

    readers: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
    file = io.BytesIO(data)
    while file.tell() < len(data):
        opcode, length = _head(file)
        if length > len(data) - file.tell():
            msg = f"a record of a chunk claims {length:,} bytes"
            raise ValueError(msg)
        content = file.read(length)
        if opcode == Opcode.MESSAGE:
            yield _message(content)
        elif opcode in readers:
            yield readers[opcode].read(_stream(content))


def _read(reader: Any, size: int) -> bytes:
    """Decompress a chunk that is said to have so many bytes, and not a byte more than one."""
    with reader:
        try:
            data: bytes = reader.read(size + 1)
        except Exception as error:  # noqa: BLE001  # each codec has errors of its own
            msg = f"a chunk cannot be decompressed ({error})"
            raise ValueError(msg) from None
    if len(data) != size:
        msg = f"a chunk claims {size:,} bytes, and has not as many"
        raise ValueError(msg)
    return data


def _zstd_reader(data: bytes) -> Any:
    import zstandard

    return zstandard.ZstdDecompressor().stream_reader(data)


def _lz4_reader(data: bytes) -> Any:
    import lz4.frame

    return lz4.frame.LZ4FrameFile(io.BytesIO(data), mode="rb")
