"""Numbers over time: width, force, torque, activity, and what third parties record."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr

from exumi_data.episode import StreamView
from exumi_data.model.streams import AudioStream, WrenchStream
from exumi_data.view.log import Log
from exumi_data.view.panels import Panel

__all__ = [
    "QUIET",
    "Curve",
    "colour_of",
    "log_audio",
    "log_numbers",
    "log_width",
    "log_wrench",
    "name_curve",
]

Colour = tuple[int, int, int]

QUIET: Colour = (139, 149, 162)
_SIDES: dict[str, Colour] = {"left": (45, 212, 191), "right": (251, 146, 180)}
_AXES: dict[str, Colour] = {"x": (240, 84, 84), "y": (110, 200, 90), "z": (90, 150, 250)}

_BLOCK_ROWS = 1 << 15
_MOST_COLUMNS = 16
_FULL_SCALE = 32768.0


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve of a panel.

    Attributes
    ----------
    path : str
    name : str
        As the legend has it.
    colour : (int, int, int) or None
        None leaves it to the viewer.
    """

    path: str
    name: str
    colour: Colour | None = None


def colour_of(name: str) -> Colour | None:
    """Return the colour of a stream: that of its side, if it has one."""
    return _SIDES.get(name.rpartition("_")[2])


def name_curve(log: Log, curve: Curve, panel: Panel, *, width: float = 1.5) -> None:
    """Log how a curve looks, and where it is drawn."""
    log.place(panel)
    colours = None if curve.colour is None else [curve.colour]
    log.fixed(curve.path, rr.SeriesLines(names=[curve.name], colors=colours, widths=[width]))


def log_width(log: Log, stream: StreamView) -> None:
    """Log a gripper's width, metres."""
    curve = Curve(f"/width/{stream.name}", stream.name, colour_of(stream.name))
    _log_columns(log, stream, {curve: Panel("curves", "/width", "Width, m")})


def log_wrench(log: Log, stream: StreamView) -> None:
    """Log forces, newton, and torques, newton metres."""
    assert isinstance(stream.metadata, WrenchStream)  # noqa: S101  # by its kind
    curves = {}
    for component in stream.metadata.components:
        what, unit = ("torque", "N·m") if component.startswith("t") else ("force", "N")
        colour = _AXES.get(component[1:])
        path = f"/{what}/{stream.name}/{component}"
        panel = Panel("curves", f"/{what}", f"{what.capitalize()}, {unit}")
        curves[Curve(path, f"{stream.name} {component}", colour)] = panel
    _log_columns(log, stream, curves)


def log_numbers(log: Log, stream: StreamView) -> bool:
    """Log a third party's numbers; return whether there were any.

    Parameters
    ----------
    log : Log
    stream : StreamView
        Of a kind that the standard does not know.
    """
    if "data" not in stream.metadata.arrays or not len(stream):
        return False
    first = stream.rows("data", 0, 1)
    columns = first.size
    if first.dtype.kind not in "iufb" or first.ndim > 2 or not 0 < columns <= _MOST_COLUMNS:
        return False
    base = f"/other/{stream.name}"
    panel = Panel("curves", base, f"{stream.name} ({stream.kind})")
    names = [stream.name] if first.ndim == 1 else [f"{stream.name} {i}" for i in range(columns)]
    _log_columns(log, stream, {Curve(f"{base}/{i}", n): panel for i, n in enumerate(names)})
    return True


def log_audio(log: Log, stream: StreamView) -> None:
    """Log how loud each block of sound is: its root mean square, as a share of full scale."""
    assert isinstance(stream.metadata, AudioStream)  # noqa: S101  # by its kind
    curve = Curve(f"/sound/{stream.name}", f"{stream.name} rms")
    name_curve(log, curve, Panel("curves", "/sound", "Sound, of full scale"))
    offset = stream.array("offset").astype(np.int64)
    levels = np.full(len(stream), np.nan)
    for block in range(len(stream)):
        samples = stream.samples(int(offset[block]), int(offset[block + 1])) / _FULL_SCALE
        if samples.size:
            levels[block] = np.sqrt(np.square(samples).mean())
    log.rows(curve.path, stream.time, rr.Scalars.columns(scalars=levels))
    log.on_samples(len(stream))


def _log_columns(log: Log, stream: StreamView, curves: Mapping[Curve, Panel]) -> None:
    for curve, panel in curves.items():
        name_curve(log, curve, panel)
    for time, data in _blocks(stream):
        values = data.reshape(len(data), -1).astype(np.float64)
        for column, curve in enumerate(curves):
            log.rows(curve.path, time, rr.Scalars.columns(scalars=values[:, column]))
        log.on_samples(len(data))


def _blocks(stream: StreamView) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    time = stream.time
    for start in range(0, len(time), _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, len(time))
        yield time[start:stop], stream.rows("data", start, stop)
