"""Streams whose payloads have no fixed length: images kept byte for byte, and blocks of sound."""

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from exumi_data.errors import DamagedDataError
from exumi_data.model.clock import Clock
from exumi_data.model.images import EncodedImages
from exumi_data.store import jpeg
from exumi_recorders.contract import Blocks, Files, Port
from exumi_recorders.finalise.columns import Columns
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.rows import common_fields
from exumi_recorders.finalise.touch import ReferenceFrames, set_reference
from exumi_recorders.journal.reading import Block

__all__ = ["add_files", "write_files"]


class _Form(Protocol):
    """What the payloads of a stream are."""

    fields: dict[str, Any]
    text: str

    def is_whole(self, payload: bytes) -> bool: ...
    def value(self, payload: bytes) -> Any: ...


class _Jpegs:
    """Images: only their headers are looked at."""

    def __init__(self, payload: Files) -> None:
        self._size = (payload.height, payload.width, payload.channels)
        height, width, channels = self._size
        images = EncodedImages(
            encoding="encoded",
            media_type="image/jpeg",
            height=height,
            width=width,
            channels=3 if channels == 3 else 1,
        )
        self.fields = {"images": images}
        self.text = f"no JPEG of {width}x{height} with {channels} channels"

    def is_whole(self, payload: bytes) -> bool:
        if not jpeg.is_jpeg(payload):
            return False
        try:
            return jpeg.size_of(payload) == self._size
        except DamagedDataError:
            return False

    def value(self, payload: bytes) -> bytes:
        return payload


class _Sound:
    """Blocks of 16-bit samples."""

    def __init__(self, payload: Blocks) -> None:
        self._channels = payload.channels
        self.fields = {"rate": payload.rate, "channels": payload.channels}
        self.text = f"no sound of {payload.channels} channels"

    def is_whole(self, payload: bytes) -> bool:
        return bool(payload) and len(payload) % (2 * self._channels) == 0

    def value(self, payload: bytes) -> np.ndarray:
        return np.frombuffer(payload, "<i2").reshape(-1, self._channels)


def write_files(
    name: str,
    port: Port,
    clock: Clock,
    log: Iterable[Block],
    columns: Columns,
    context: Context,
) -> Any:
    """Write a stream of images or of sound.

    What is no file of the stream is left out, counted, and noted.

    Parameters
    ----------
    name : str
    port : Port
    clock : Clock
    log : iterable of Block
    columns : Columns
    context : Context

    Returns
    -------
    StreamWriter or None
        None where there is not a single sample.
    """
    form = _form_of(port)
    reference = ReferenceFrames.wanted(port.kind, name, context)
    out: Any = None
    left_out = 0
    for block in log:
        kept = np.array([form.is_whole(file) for file in block.files], np.bool_)
        left_out += int((~kept).sum())
        beside = columns.of(block, kept)
        if not kept.any():
            continue
        if out is None:
            out = add_files(name, port, clock, context)
        files = _chosen(block.files, kept)
        if reference is not None:
            reference.take(out.count, beside["time_host"], files)
        out.append(beside.pop("time"), [form.value(file) for file in files], **beside)
    if left_out:
        text = f"{left_out} payloads of {name} were {form.text}"
        context.note("files-left-out", text, None if out is None else name)
    if out is not None:
        set_reference(out, name, context, reference)
    return out


def add_files(name: str, port: Port, clock: Clock, context: Context) -> Any:
    """Add a stream of images or of sound to the episode; return its writer.

    Parameters
    ----------
    name : str
    port : Port
    clock : Clock
    context : Context
    """
    fields = {**common_fields(port), **port.metadata, **_form_of(port).fields}
    return context.writer.add_stream(name, kind=port.kind, clock=clock, **fields)


def _form_of(port: Port) -> _Form:
    if isinstance(port.payload, Files):
        return _Jpegs(port.payload)
    assert isinstance(port.payload, Blocks)  # noqa: S101  # rows are written elsewhere
    return _Sound(port.payload)


def _chosen(files: list[bytes], kept: npt.NDArray[np.bool_]) -> list[bytes]:
    if kept.all():
        return files
    return [file for file, good in zip(files, kept.tolist(), strict=True) if good]
