"""Streams of numbers: rows of bytes become `data`, with `raw` beside it where they differ."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.model.clock import Clock
from exumi_data.model.streams import RawData
from exumi_data.width_map import NOT_CALIBRATED, WIDTH_MAP, WidthMap, read_width_map
from exumi_recorders.contract import Port, Rows
from exumi_recorders.finalise.columns import Columns
from exumi_recorders.finalise.context import Context
from exumi_recorders.finalise.losses import FLAG
from exumi_recorders.finalise.poses import PoseSigns, to_world
from exumi_recorders.journal.header import StreamHeader, port_of
from exumi_recorders.journal.reading import Block

__all__ = ["common_fields", "payload_bytes_of", "row_dtype", "write_rows"]


@dataclass(slots=True, eq=False)
class _Values:
    """What a block of rows becomes.

    Attributes
    ----------
    data : (N, ...) ndarray
    raw : (N, ...) ndarray or None
    flags : (N,) uint32
        ``invalid`` and ``out_of_range``, beside what the driver said.
    """

    data: np.ndarray
    raw: np.ndarray | None
    flags: npt.NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class _Transform:
    """How the rows of a stream become values.

    Attributes
    ----------
    fields : dict
        Of the stream's metadata, such as `raw`.
    values : callable
        From rows (structured, N) and host times (N,) to `_Values`.
    """

    fields: dict[str, Any]
    values: Callable[[np.ndarray, npt.NDArray[np.int64]], _Values]


def row_dtype(payload: Rows) -> np.dtype[np.void]:
    """Return the type of one packed row.

    Parameters
    ----------
    payload : Rows
    """
    return np.dtype(
        [
            (name, np.dtype(dtype).newbyteorder("<"), shape)
            for name, (dtype, shape) in payload.arrays.items()
        ]
    )


def payload_bytes_of(stream: StreamHeader) -> int | None:
    """Return the length of all payloads of a stream; None where they differ.

    Parameters
    ----------
    stream : StreamHeader
    """
    payload = port_of(stream.port).payload
    return row_dtype(payload).itemsize if isinstance(payload, Rows) else None


def common_fields(port: Port) -> dict[str, Any]:
    """Return the metadata that all kinds of streams have, where they are known.

    Parameters
    ----------
    port : Port
    """
    fields = {
        "nominal_rate": port.nominal_rate,
        "sensor": port.sensor,
        "time_device_unit": port.time_device_unit,
    }
    return {key: value for key, value in fields.items() if value is not None}


def write_rows(
    name: str,
    device: str,
    port: Port,
    clock: Clock,
    log: Iterable[Block],
    columns: Columns,
    context: Context,
) -> Any:
    """Write a stream of numbers.

    Parameters
    ----------
    name, device : str
    port : Port
    clock : Clock
    log : iterable of Block
        Its records have one length.
    columns : Columns
    context : Context

    Returns
    -------
    DataStreamWriter or None
        None where there is not a single sample.
    """
    assert isinstance(port.payload, Rows)  # noqa: S101  # the caller saw to it
    dtype = row_dtype(port.payload)
    out: Any = None
    for block in log:
        if out is None:
            transform = _transform_of(port, device, name, context)
            fields = {**common_fields(port), **port.metadata, **transform.fields}
            out = context.writer.add_stream(name, kind=port.kind, clock=clock, **fields)
            if port.valid is not None:
                out.set_valid(np.array(port.valid, np.bool_))
        assert block.rows is not None  # noqa: S101  # the log has rows of one length
        rows = block.rows.view(dtype).reshape(len(block))
        values = transform.values(rows, block.time_host)
        beside = columns.of(block)
        own = beside["flags"]
        beside["flags"] = own | values.flags
        beside["flags"][own & FLAG["invalid"] != 0] &= ~np.uint32(FLAG["out_of_range"])
        raw = {} if values.raw is None else {"raw": values.raw}
        out.append(beside.pop("time"), values.data, **raw, **beside)
    return out


def _transform_of(port: Port, device: str, stream: str, context: Context) -> _Transform:
    """Return how the rows of a port become values.

    Parameters
    ----------
    port : Port
    device, stream : str
    context : Context
        Calibration items are looked up and added, and notes left.
    """
    if port.transform == "world_frame":
        return _poses(port, device, stream, context)
    if port.transform == "encoder_map":
        return _widths(port, stream, context)
    signs = PoseSigns() if port.kind == "pose" else None

    def plain(rows: np.ndarray, _: npt.NDArray[np.int64]) -> _Values:
        names = rows.dtype.names or ()
        raw = rows["raw"] if "raw" in names else None
        data, flags = _finite(rows["data"])
        if raw is not None:
            raw, more = _finite(raw)
            flags |= more
        if signs is not None:
            data = signs.take(data.astype(np.float64), np.isfinite(data).all(axis=1))
        return _Values(data, raw, flags)

    return _Transform({}, plain)


def _finite(values: np.ndarray) -> tuple[np.ndarray, npt.NDArray[np.uint32]]:
    """Flag rows that hold no numbers; an infinity becomes NaN."""
    flags = np.zeros(len(values), np.uint32)
    if values.dtype.kind == "f":
        finite = np.isfinite(values)
        if not finite.all():
            values = np.where(finite, values, np.nan).astype(values.dtype)
            flags[~finite.reshape(len(values), -1).all(axis=1)] = FLAG["invalid"]
    return values, flags


def _raw(port: Port, transform: str | None) -> dict[str, Any]:
    """Return the metadata of `raw`, as the driver stated it and with what leads from it to data."""
    default = "m" if port.kind == "pose" else "count"
    stated = {"unit": default, **dict(port.metadata.get("raw") or {})}
    if transform is not None:
        stated["transform"] = transform
    return {"raw": RawData.model_validate(stated)}


def _poses(port: Port, device: str, stream: str, context: Context) -> _Transform:
    world = context.world_of(device, stream)
    signs = PoseSigns()

    def transformed(rows: np.ndarray, time_host: npt.NDArray[np.int64]) -> _Values:
        raw, flags = _finite(rows["raw"])
        # What was marked first holds for what came before it as well.
        which = np.searchsorted(np.array(world.since_ns[1:]), time_host, side="right")
        poses = np.empty((len(raw), 7))
        valid = np.zeros(len(raw), np.bool_)
        for number in np.unique(which).tolist():
            own = which == number
            poses[own], valid[own] = to_world(raw[own], world.poses[number])
        flags[~valid] |= FLAG["invalid"]
        return _Values(signs.take(poses, valid), raw, flags)

    return _Transform(_raw(port, world.item), transformed)


def _widths(port: Port, stream: str, context: Context) -> _Transform:
    item = context.calibration.get(WIDTH_MAP)
    modulus = _raw(port, None)["raw"].modulus
    found = "there is no such item" if item is None else read_width_map(item.value, modulus)
    known = found if isinstance(found, WidthMap) else None
    if known is None:
        context.note(
            NOT_CALIBRATED,
            f"no width is known, only `raw`: of the calibration {WIDTH_MAP!r}, {found}",
            stream,
        )
    fields = _raw(port, None if known is None else WIDTH_MAP)

    def transformed(rows: np.ndarray, _: npt.NDArray[np.int64]) -> _Values:
        raw = rows["raw"]
        flags = np.zeros(len(raw), np.uint32)
        if known is None:
            # Of what the device itself calls invalid only that is said: a map, once there is one
            # (`exumi calibrate apply`), makes widths of the others.
            flags |= FLAG["invalid"] | FLAG["out_of_range"]
            return _Values(np.full(len(raw), np.nan, np.float32), raw, flags)
        widths, outside = known.widths(raw, modulus)
        flags[outside] |= FLAG["out_of_range"]
        return _Values(widths, raw, flags)

    return _Transform(fields, transformed)
