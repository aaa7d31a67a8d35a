"""The parts of a buffer are put together: nothing is coded again."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.exporter import ExportPlan, Part
from exumi_converters.umi.part import CHUNKS, TABLE, numbers_file
from exumi_converters.umi.reading import MARK
from exumi_converters.umi.sinks import Sink, open_sink

__all__ = ["assemble"]

_CHUNK_ROWS = 16384
_NUMBERS = {
    "eef_pos": ("<f4", 3),
    "eef_rot_axis_angle": ("<f4", 3),
    "gripper_width": ("<f4", 1),
    "demo_start_pose": ("<f8", 6),
    "demo_end_pose": ("<f8", 6),
}
_GROUP = {"zarr_format": 2}


def assemble(
    parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
) -> None:
    """Put parts together.

    Parameters
    ----------
    parts : sequence of Part
    target : pathlib.Path
        A new, empty folder, or the name of a zip to make.
    plan : ExportPlan
    about : mapping
        Goes into the root's attributes, which training code does not look at.
    """
    ends = np.cumsum([part.result["rows"] for part in parts], dtype=np.int64)
    rows = int(ends[-1])
    with open_sink(target) as sink:
        for group in ("", "data/", "meta/"):
            sink.put(f"{group}.zgroup", _json(_GROUP))
        sink.put(".zattrs", _json({MARK: {**about, "rate": plan.shared["rate"]}}))
        _put_array(sink, "meta/episode_ends", (len(ends),), (len(ends),), "<i8", None)
        sink.put("meta/episode_ends/0", ends.tobytes())
        images = plan.shared["images"]
        for name, one in images.items():
            shape, chunk = (rows, *one["shape"]), (1, *one["chunk"])
            _put_array(sink, f"data/{name}", shape, chunk, "|u1", one["codec"])
        for robot in range(plan.shared["robots"]):
            for what, (dtype, width) in _NUMBERS.items():
                _put_numbers(sink, f"robot{robot}_{what}", dtype, width, parts, rows)
        for part, stop in zip(parts, ends.tolist(), strict=True):
            _put_frames(sink, part, stop - part.result["rows"], images)


def _json(value: Mapping[str, Any]) -> bytes:
    return (json.dumps(value, indent=4, sort_keys=True, allow_nan=False) + "\n").encode()


def _put_array(
    sink: Sink,
    path: str,
    shape: tuple[int, ...],
    chunks: tuple[int, ...],
    dtype: str,
    codec: dict[str, Any] | None,
) -> None:
    document = {
        "chunks": list(chunks),
        "compressor": codec,
        "dtype": dtype,
        "fill_value": 0,
        "filters": None,
        "order": "C",
        "shape": list(shape),
        "zarr_format": 2,
    }
    sink.put(f"{path}/.zarray", _json(document))


def _put_numbers(
    sink: Sink, name: str, dtype: str, width: int, parts: Sequence[Part], rows: int
) -> None:
    """Write an array of numbers, uncompressed as UMI does, with few chunks."""
    chunk = min(_CHUNK_ROWS, rows)
    _put_array(sink, f"data/{name}", (rows, width), (chunk, width), dtype, None)
    block, filled, number = np.zeros((chunk, width), dtype), 0, 0
    for values in _values(parts, name):
        at = 0
        while at < len(values):
            taken = min(chunk - filled, len(values) - at)
            block[filled : filled + taken] = values[at : at + taken]
            filled, at = filled + taken, at + taken
            if filled == chunk:
                sink.put(f"data/{name}/{number}.0", block.tobytes())
                block[:] = 0
                filled, number = 0, number + 1
    if filled:
        sink.put(f"data/{name}/{number}.0", block.tobytes())


def _values(parts: Sequence[Part], name: str) -> Iterator[np.ndarray]:
    for part in parts:
        yield np.load(part.folder / numbers_file(name), allow_pickle=False)


def _put_frames(sink: Sink, part: Part, start: int, images: Mapping[str, Any]) -> None:
    """Give the coded frames of one part their rows; what was copied is removed."""
    if not images:
        return
    names = [
        (f"data/{name}", channel)
        for name, one in images.items()
        for channel in range(one["shape"][2] // one["chunk"][2])
    ]
    sizes = np.load(part.folder / TABLE, allow_pickle=False)
    with (part.folder / CHUNKS).open("rb") as file:
        for row, of_row in enumerate(sizes.tolist(), start):
            for (path, channel), size in zip(names, of_row, strict=True):
                sink.put(f"{path}/{row}.0.0.{channel}", file.read(size))
    (part.folder / CHUNKS).unlink()
