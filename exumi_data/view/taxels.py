"""Grids of force-sensitive cells as a heat map."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import rerun as rr

from exumi_data.episode import StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.model.streams import TaxelsStream
from exumi_data.view.curves import QUIET
from exumi_data.view.log import Log
from exumi_data.view.panels import Panel

__all__ = ["log_taxels"]

_BLOCK_BYTES = 4 << 20


def log_taxels(log: Log, stream: StreamView) -> None:
    """Log a taxel stream: what each cell says above its value without contact.

    Values are ``sign * (value - offset)``, in the stream's unit, so that they rise with the force.
    Cells that are not valid are 0 and crossed out.

    Parameters
    ----------
    log : Log
    stream : StreamView
        Of kind ``taxels``.

    Raises
    ------
    DamagedDataError
        The mask does not fit the grid.
    """
    metadata = stream.metadata
    assert isinstance(metadata, TaxelsStream)  # noqa: S101  # by its kind
    rows, columns = metadata.grid
    valid = stream.valid
    if valid is not None and valid.shape != (rows, columns):
        raise DamagedDataError(f"`valid` is {valid.shape}, the grid {rows}x{columns}")
    path = f"/taxels/{stream.name}"
    highest = max(
        (float(v[np.isfinite(v)].max(initial=0.0)) for _, v in _blocks(stream)), default=0
    )
    layout = rr.components.ImageFormat(
        width=columns, height=rows, channel_datatype=rr.ChannelDatatype.F32
    )
    log.fixed(
        path,
        rr.DepthImage.from_fields(
            format=layout,
            colormap=rr.components.Colormap.Inferno,
            depth_range=[0.0, highest or 1.0],
            meter=1.0,
        ),
    )
    if valid is not None and not valid.all():
        log.fixed(f"{path}/dead", _crosses(valid))
    for taken, values in _blocks(stream):
        buffers = [np.frombuffer(one.tobytes(), np.uint8) for one in values]
        log.rows(path, stream.time[taken], rr.DepthImage.columns(buffer=buffers))
        log.on_samples(len(values))
    log.place(Panel("taxels", path, f"{stream.name}, {metadata.unit}"))


def _crosses(valid: npt.NDArray[np.bool_]) -> rr.LineStrips2D:
    """Return a cross on each cell that is not valid."""
    corners = np.argwhere(~valid)[:, ::-1].astype(np.float64)  # column, row
    strokes = [
        [corner + start, corner + end]
        for corner in corners
        for start, end in (((0.1, 0.1), (0.9, 0.9)), ((0.9, 0.1), (0.1, 0.9)))
    ]
    return rr.LineStrips2D(strokes, colors=[QUIET] * len(strokes), radii=rr.Radius.ui_points(1.0))


def _blocks(stream: StreamView) -> Iterator[tuple[slice, npt.NDArray[np.float32]]]:
    metadata = stream.metadata
    assert isinstance(metadata, TaxelsStream)  # noqa: S101  # by its kind
    rows, columns = metadata.grid
    step = max(1, _BLOCK_BYTES // (rows * columns * 4))
    dead = None if stream.valid is None else ~stream.valid
    for start in range(0, len(stream), step):
        stop = min(start + step, len(stream))
        data = stream.rows("data", start, stop)
        if data.shape[1:] != (rows, columns):
            raise DamagedDataError(f"`data` is {data.shape[1:]}, the grid {rows}x{columns}")
        values = (metadata.sign * (data.astype(np.float64) - metadata.offset)).astype(np.float32)
        if dead is not None:
            values[:, dead] = 0.0  # the viewer draws NaN as the hottest
        yield slice(start, stop), values
