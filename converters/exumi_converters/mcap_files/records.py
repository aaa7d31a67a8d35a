"""The records of an MCAP file in its order: bounded whatever it claims, and up to damage."""

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from exumi_data.errors import LimitError

__all__ = ["Records"]

_RECORD_BYTES = 2 * 1024**3
_CHUNK_BYTES = 512 * 1024**2


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
        """Yield records; those within chunks come in their order, those of the summary too.

        Raises
        ------
        LimitError
            A chunk holds more than 512 MiB.
        """
        from mcap.exceptions import McapError
        from mcap.records import Chunk
        from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

        with self.path.open("rb") as file:
            reader = StreamReader(
                file, emit_chunks=True, record_size_limit=min(_RECORD_BYTES, self._size())
            )
            try:
                for record in reader.records:
                    if isinstance(record, Chunk):
                        yield from breakup_chunk(self._inflated(record), validate_crc=True)
                    else:
                        yield record
            except (McapError, CRCValidationError, struct.error, UnicodeDecodeError) as error:
                self.damage = str(error) or type(error).__name__
            except (ValueError, EOFError) as error:
                self.damage = str(error)

    def _size(self) -> int:
        return self.path.stat().st_size

    def _inflated(self, chunk: Any) -> Any:
        """Decompress a chunk without trusting what it says of its size."""
        if chunk.uncompressed_size > _CHUNK_BYTES:
            raise self._too_much()
        if chunk.compression == "zstd":
            data = self._read(_zstd_reader(chunk.data))
        elif chunk.compression == "lz4":
            data = self._read(_lz4_reader(chunk.data))
        else:
            return chunk
        return replace(chunk, compression="", data=data)

    def _read(self, reader: Any) -> bytes:
        with reader:
            try:
                data: bytes = reader.read(_CHUNK_BYTES + 1)
            except Exception as error:  # noqa: BLE001  # each codec has errors of its own
                msg = f"a chunk cannot be decompressed ({error})"
                raise ValueError(msg) from None
        if len(data) > _CHUNK_BYTES:
            raise self._too_much()
        return data

    def _too_much(self) -> LimitError:
        return LimitError(
            f"a chunk holds more than {_CHUNK_BYTES >> 20} MiB",
            where=self.path,
            fix="Write the file again in smaller chunks: mcap compress --chunk-size",
        )


def _zstd_reader(data: bytes) -> Any:
    import zstandard

    return zstandard.ZstdDecompressor().stream_reader(data)


def _lz4_reader(data: bytes) -> Any:
    import lz4.frame

    return lz4.frame.LZ4FrameFile(io.BytesIO(data), mode="rb")
