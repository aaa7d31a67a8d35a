"""The values of streams at the steps of an episode."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from exumi_converters.oxt.places import Place
from exumi_converters.oxt.steps import Samples, Steps
from exumi_converters.oxt.store import chunk_name, encode
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.geometry import interpolate_linear, interpolate_poses
from exumi_data.time import nearest_indices

__all__ = ["seconds", "write_frames", "write_numbers"]

_BLOCK = 2048
_NS = 1_000_000_000


def write_frames(episode: Episode, place: Place, steps: Steps, folder: Path) -> None:
    """Write the frame nearest to each step as a file of its own; nothing is blended.

    Parameters
    ----------
    episode : Episode
    place : Place
        Of images.
    steps : Steps
    folder : pathlib.Path
        New; named after the steps, counted from 0.
    """
    folder.mkdir(parents=True)
    dimensions = 1 + len(place.row)
    pads = place.kind == "tactile"
    for pad, name in enumerate(place.streams):
        stream = episode[name]
        chosen = _nearest(Samples.of(stream), steps)
        last, content = -1, b""
        for step, index in enumerate(chosen.tolist()):
            if index != last:
                last, content = index, encode(_rgb(stream.frames[index]))
            piece = (pad,) if pads else ()
            (folder / chunk_name(step, *piece, dimensions=dimensions)).write_bytes(content)


def _rgb(frame: np.ndarray) -> np.ndarray:
    """Return three channels: the contract has no grey images."""
    return frame if frame.shape[2] == 3 else np.repeat(frame, 3, axis=2)


def _nearest(samples: Samples, steps: Steps) -> np.ndarray:
    """Return the sample nearest to each step, as counted in the stream."""
    reach = int(np.ptp(np.concatenate((samples.time_ns, steps.time_ns))))
    return np.asarray(samples.index[nearest_indices(samples.time_ns, steps.time_ns, reach)])


def write_numbers(episode: Episode, place: Place, steps: Steps, path: Path) -> None:
    """Write a stream's values at the steps as one ``.npy`` file.

    Parameters
    ----------
    episode : Episode
    place : Place
        Of numbers.
    steps : Steps
    path : pathlib.Path

    Raises
    ------
    DamagedDataError
        A value is not finite, and not flagged invalid.
    """
    shape = (len(steps.time_ns), *place.row)
    out = np.lib.format.open_memmap(path, mode="w+", dtype=np.dtype(place.dtype), shape=shape)
    stream = episode[place.streams[0]]
    done = 0
    try:
        for values in _values(stream, place, steps):
            out[done : done + len(values)] = values.reshape(len(values), *place.row)
            done += len(values)
    except ValueError as error:
        fix = "exumi validate says where."
        raise DamagedDataError(
            f"stream {stream.name!r}: {error}", where=episode.path, fix=fix
        ) from None
    finally:
        out.flush()


def _values(stream: StreamView, place: Place, steps: Steps) -> Iterator[np.ndarray]:
    samples = Samples.of(stream)
    for start in range(0, len(steps.time_ns), _BLOCK):
        ticks = steps.time_ns[start : start + _BLOCK]
        if place.kind == "taxels":
            yield _rows(stream, _nearest(samples, Steps(ticks, (), 0, {})))
            continue
        first = max(0, int(np.searchsorted(samples.time_ns, ticks[0], "right")) - 1)
        stop = int(np.searchsorted(samples.time_ns, ticks[-1], "right")) + 1
        time = samples.time_ns[first:stop]
        rows = _rows(stream, samples.index[first:stop])
        if place.kind == "pose":
            poses, _ = interpolate_poses(time, rows, ticks, samples.gap_ns)
            yield _six_numbers(poses, int(place.about["turned_about_z_deg"]))
        else:
            yield interpolate_linear(time, rows, ticks, samples.gap_ns)[0]


def _rows(stream: StreamView, index: np.ndarray) -> np.ndarray:
    """Read the samples of a stream that are asked for, and no more than lie between them.

    Raises
    ------
    ValueError
        One is not finite.
    """
    first = int(index.min())
    rows = np.asarray(stream.rows("data", first, int(index.max()) + 1)[index - first])
    finite = np.isfinite(rows.reshape(len(rows), -1)).all(axis=1)
    if not finite.all():
        place = int(index[np.argmin(finite)])
        raise ValueError(f"sample {place} is not finite, and it is not flagged invalid")
    return rows


def _six_numbers(poses: np.ndarray, turned_deg: int) -> np.ndarray:
    """Return position and rotation vector, after turning the axes about the pose's own z."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(poses[:, 3:])
    if turned_deg:
        rotation = rotation * Rotation.from_euler("z", turned_deg, degrees=True)
    return np.concatenate([poses[:, :3], rotation.as_rotvec()], axis=1)


def seconds(time_ns: np.ndarray) -> np.ndarray:
    """Return times in seconds: exact to the nanosecond for the first 52 days.

    Parameters
    ----------
    time_ns : (T,) int64
    """
    return np.asarray(time_ns / np.float64(_NS))
