"""One episode's rows, until they are put together: numbers as arrays, coded frames end to end."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.exporter import ExportItem, ExportPlan
from exumi_converters.resize import resize
from exumi_converters.umi.channels import difference_channels
from exumi_converters.umi.encoding import encoder
from exumi_converters.umi.layout import TACTILE_COMBINED
from exumi_converters.umi.slots import Slots, Timeline, good_samples, tick_times, tolerance_ns
from exumi_data.calibration import rectification_of
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.geometry import interpolate_linear, interpolate_poses
from exumi_data.store.shards import ArrayReader, open_array
from exumi_data.tactile import to_grey
from exumi_data.tactile.combined import Combiner
from exumi_data.ticks import max_gap_ns
from exumi_data.time import nearest_indices, parse_rate

__all__ = ["CHUNKS", "TABLE", "numbers_file", "write_part"]

CHUNKS = "chunks.bin"
"""Coded frames, end to end."""
TABLE = "chunks.npy"
"""Their sizes, (rows, chunks a row): in the order of the plan's images, each chunk by chunk."""

_BATCH = 16


def numbers_file(name: str) -> str:
    """Return the name of the file of an array of numbers."""
    return f"{name}.npy"


def write_part(
    item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
) -> dict[str, Any]:
    """Write the rows of one episode.

    Returns
    -------
    dict
        ``rows`` and ``frames``.
    """
    slots = Slots(**item.settings["slots"])
    timeline = Timeline(plan.shared["timeline"], parse_rate(plan.shared["rate"]))
    whole = tick_times(episode, slots, timeline)
    ticks = whole[item.settings["first"] : item.settings["stop"]]
    for number in slots.poses:
        for name, values in _numbers(episode, slots, number, ticks).items():
            np.save(folder / numbers_file(name), values, allow_pickle=False)
    sources = {
        name: _source(name, episode, slots, plan, whole, ticks, timeline)
        for name in plan.shared["images"]
    }
    frames = _write_frames(folder, sources, plan.shared["images"], len(ticks))
    return {"rows": len(ticks), "frames": frames}


def _numbers(
    episode: Episode, slots: Slots, number: str, ticks: np.ndarray
) -> dict[str, np.ndarray]:
    from scipy.spatial.transform import Rotation

    view, robot = episode[slots.poses[number]], f"robot{number}"
    good = good_samples(view)
    poses, _ = interpolate_poses(view.time[good], view.data[good], ticks, max_gap_ns(view.time))
    vectors = np.asarray(Rotation.from_quat(poses[:, 3:]).as_rotvec())
    six = np.concatenate([poses[:, :3], vectors], axis=1)
    width = episode[slots.widths[number]]
    good = good_samples(width)
    opening, _ = interpolate_linear(
        width.time[good], width.data[good], ticks, max_gap_ns(width.time)
    )
    return {
        f"{robot}_eef_pos": six[:, :3].astype(np.float32),
        f"{robot}_eef_rot_axis_angle": six[:, 3:].astype(np.float32),
        f"{robot}_gripper_width": opening.astype(np.float32).reshape(-1, 1),
        f"{robot}_demo_start_pose": np.tile(_end_of(view, "start", six[0]), (len(six), 1)),
        f"{robot}_demo_end_pose": np.tile(_end_of(view, "end", six[-1]), (len(six), 1)),
    }


def _end_of(view: StreamView, end: str, pose: np.ndarray) -> np.ndarray:
    """Return the pose at the demonstration's start or end: the one kept from a buffer, or a row."""
    kept = (view.metadata.model_extra or {}).get(f"umi:demo_{end}_pose")
    if isinstance(kept, list) and len(kept) == 6 and all(isinstance(n, int | float) for n in kept):
        return np.array(kept, np.float64)
    return np.asarray(pose, np.float64)


_Frames = Callable[[], Iterator[np.ndarray]]


def _source(
    name: str,
    episode: Episode,
    slots: Slots,
    plan: ExportPlan,
    whole: np.ndarray,
    ticks: np.ndarray,
    timeline: Timeline,
) -> _Frames:
    def nearest(view: StreamView) -> np.ndarray:
        good = np.flatnonzero(good_samples(view))
        tolerance = tolerance_ns(view, whole, timeline)
        return good[nearest_indices(view.time[good], ticks, tolerance)]

    shape = plan.shared["images"][name]["shape"]
    if name != TACTILE_COMBINED:
        view = episode[slots.cameras[name.removeprefix("camera").removesuffix("_rgb")]]
        indices, crop = nearest(view), plan.shared["crop"] and bool(plan.shared["size"])
        return lambda: (_fitted(_cut(f) if crop else f, shape) for f in _read(view, indices))
    views = {side: episode[stream] for side, stream in slots.tactile.items()}
    indices_of = {side: nearest(view) for side, view in views.items()}
    if "differences" in views:
        return lambda: (_fitted(f, shape) for f in _kept_channels(episode, views, indices_of))
    return lambda: (_fitted(f, shape) for f in _made_channels(episode, views, indices_of))


def _read(view: StreamView, indices: np.ndarray, *, grey: bool = False) -> Iterator[np.ndarray]:
    """Yield frames in order; one that is wanted twice in a row is decoded once."""
    for first in range(0, len(indices), _BATCH):
        wanted = indices[first : first + _BATCH]
        distinct, place = np.unique(wanted, return_inverse=True)
        frames = view.frames.read(distinct.tolist(), grey=grey)
        for at in place.tolist():
            yield frames[at]


def _cut(frame: np.ndarray) -> np.ndarray:
    """Cut a frame to the square in its middle."""
    height, width = frame.shape[:2]
    edge = min(height, width)
    top, left = (height - edge) // 2, (width - edge) // 2
    return frame[top : top + edge, left : left + edge]


def _fitted(frame: np.ndarray, shape: list[int]) -> np.ndarray:
    if list(frame.shape[:2]) != shape[:2]:
        frame = resize(np.ascontiguousarray(frame), shape[0])
    if frame.shape[2] != shape[2]:
        frame = np.repeat(frame, shape[2], axis=2)
    return frame


def _kept_channels(
    episode: Episode, views: dict[str, StreamView], indices: dict[str, np.ndarray]
) -> Iterator[np.ndarray]:
    """Yield concave, convex and grey as a buffer had them."""
    name = views["differences"].name
    data = open_array(episode.store, f"streams/{name}/data")
    if data.shape[1:] != (*views["combined"].frames.shape[1:3], 2) or data.dtype != np.uint8:
        raise DamagedDataError(f"{name} is {data.shape} {data.dtype}", where=episode.path)
    greys = _read(views["combined"], indices["combined"], grey=True)
    for both, grey in zip(_rows(data, indices["differences"]), greys, strict=True):
        yield np.concatenate([both, grey], axis=2)


def _rows(data: ArrayReader, indices: np.ndarray) -> Iterator[np.ndarray]:
    """Yield rows of an array, ascending, a few read at a time."""
    for first in range(0, len(indices), _BATCH):
        wanted = indices[first : first + _BATCH]
        start = int(wanted[0])
        block = data.rows(start, int(wanted[-1]) + 1)
        for index in wanted.tolist():
            yield block[index - start]


def _made_channels(
    episode: Episode, views: dict[str, StreamView], indices: dict[str, np.ndarray]
) -> Iterator[np.ndarray]:
    """Yield concave, convex and grey, made from grey frames and their reference."""
    if "combined" in views:
        view = views["combined"]
        reference = to_grey(_reference(view))
        for grey in _read(view, indices["combined"], grey=True):
            yield difference_channels(to_grey(grey), reference)
        return
    left, right = views["left"], views["right"]
    combine = Combiner(rectification_of(episode, left.name), rectification_of(episode, right.name))
    reference = combine(*(to_grey(_reference(v))[..., None] for v in (left, right)))
    both = zip(
        _read(left, indices["left"], grey=True),
        _read(right, indices["right"], grey=True),
        strict=True,
    )
    for ours, theirs in both:
        yield difference_channels(combine(ours, theirs)[..., 0], reference[..., 0])


def _reference(view: StreamView) -> np.ndarray:
    image = view.reference
    if image is None:
        raise DamagedDataError("the reference image is missing", where=repr(view))
    return image


def _write_frames(
    folder: Path, sources: dict[str, _Frames], described: dict[str, Any], rows: int
) -> int:
    """Code all frames, row by row; return how many there are."""
    if not sources:
        return 0
    encoders = {name: encoder(one["codec"]) for name, one in described.items()}
    sizes: list[list[int]] = []
    running = {name: source() for name, source in sources.items()}
    with (folder / CHUNKS).open("wb") as file:
        for _ in range(rows):
            row: list[int] = []
            for name, frames in running.items():
                frame = next(frames)
                each = described[name]["chunk"][2]
                for channel in range(0, frame.shape[2], each):
                    content = encoders[name](frame[..., channel : channel + each])
                    file.write(content)
                    row.append(len(content))
            sizes.append(row)
    np.save(folder / TABLE, np.array(sizes, np.int64), allow_pickle=False)
    return rows * len(sources)
