"""Shards, lengths and values of the arrays that are not images."""

from collections.abc import Iterator

import numpy as np

from exumi_data.model.streams import (
    PoseStream,
    StreamModel,
    TactileStream,
    TaxelsStream,
    WidthStream,
    WrenchStream,
)
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem
from exumi_validators.sample_flags import flagged

__all__ = [
    "finite_values",
    "lengths",
    "quaternion_norm",
    "quaternion_sign",
    "raw_modulus",
    "reference_frames",
    "shards",
    "width_range",
]

_NORM_TOLERANCE = 1e-3
_WIDTH_TOLERANCE_M = 1e-3


@check("SHARD-001", "SHARD-002", "SHARD-003", "SHARD-004", "SHARD-006")
def shards(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that shards and inner chunks are there."""
    for path in episode.array_nodes:
        yield from (p for p in episode.shard_problems(path) if p.code != "SHARD-005")


@check("ARR-004")
def lengths(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that arrays have a row for each sample."""
    for path, spec in episode.expected_arrays.items():
        top, name = path.split("/")[:2]
        reader = episode.reader(path)
        count = episode.count(name) if top in ("streams", "derived") else None
        if spec is None or reader is None or count is None or spec.shape[0] not in ("N", "N+1"):
            continue
        expected = count + (spec.shape[0] == "N+1")
        if reader.shape[0] != expected:
            found = reader.shape[0]
            pointer = ("shape",)
            file = f"{path}/zarr.json"
            yield problem("ARR-004", file, pointer=pointer, expected=expected, found=found)


def _valid_blocks(
    episode: EpisodeContext, name: str, array: str
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield (start, rows, which of them the device did not call invalid)."""
    path, flag_path = f"streams/{name}/{array}", f"streams/{name}/flags"
    reader = episode.reader(flag_path)
    data = episode.reader(path)
    has_flags = reader is not None and data is not None and reader.shape[0] == data.shape[0]
    for start, blocks in episode.blocks(path, *((flag_path,) if has_flags else ())):
        usable = np.ones(len(blocks[0]), dtype=bool)
        if has_flags:
            usable = ~flagged(blocks[1], "invalid")
        yield start, blocks[0], usable


@check("VAL-001")
def finite_values(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that what was measured is a number."""
    for name, stream in episode.streams.items():
        if not isinstance(stream, PoseStream | WidthStream | WrenchStream | TaxelsStream):
            continue
        for array in ("data", "raw"):
            node = episode.array_nodes.get(f"streams/{name}/{array}")
            if node is not None and node.dtype in ("float32", "float64"):
                yield from _not_finite(episode, name, array)


def _not_finite(episode: EpisodeContext, name: str, array: str) -> Iterator[Problem]:
    for start, rows, usable in _valid_blocks(episode, name, array):
        flat = rows.reshape(len(rows), -1)
        wrong = ~np.isfinite(flat).all(axis=1)
        if wrong.any():
            # An invalid sample may be NaN, but infinity is no way to say that there is nothing.
            wrong &= usable | np.isinf(flat).any(axis=1)
        if wrong.any():
            row = int(wrong.argmax())
            values = flat[row]
            if not usable[row]:
                values = values[~np.isnan(values)]
            yield problem(
                "VAL-001",
                f"streams/{name}/{array}",
                index=start + row,
                found=float(values[~np.isfinite(values)][0]),
                detail="the value",
            )
            return


def _streams_of(episode: EpisodeContext, model: type[StreamModel]) -> list[str]:
    return [name for name, stream in episode.streams.items() if isinstance(stream, model)]


@check("POSE-001")
def quaternion_norm(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that quaternions are rotations."""
    for name in _streams_of(episode, PoseStream):
        for start, rows, valid in _valid_blocks(episode, name, "data"):
            usable = valid & np.isfinite(rows).all(axis=1)
            with np.errstate(over="ignore"):  # a norm that is infinite is not 1
                norm = np.linalg.norm(np.where(usable[:, None], rows[:, 3:], 0.5), axis=1)
            wrong = np.abs(norm - 1) > _NORM_TOLERANCE
            if wrong.any():
                row = int(wrong.argmax())
                path = f"streams/{name}/data"
                yield problem("POSE-001", path, index=start + row, found=f"{norm[row]:.5g}")
                break


@check("POSE-002")
def quaternion_sign(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that neighbouring quaternions lie on the same side."""
    for name in _streams_of(episode, PoseStream):
        first, flips = -1, 0
        last = np.full((1, 4), np.nan)
        for start, rows, usable in _valid_blocks(episode, name, "data"):
            quaternions = np.vstack((last, rows[usable, 3:]))
            with np.errstate(over="ignore", invalid="ignore"):  # values of which other rules speak
                flipped = (quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0
            if flipped.any() and first < 0:
                first = start + int(np.flatnonzero(usable)[flipped.argmax()])
            flips += int(flipped.sum())
            last = quaternions[-1:]
        if flips:
            yield problem("POSE-002", f"streams/{name}/data", index=first, detail=flips)


@check("WIDTH-001", "WIDTH-002")
def width_range(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the width is one that the gripper can have."""
    embodiment = episode.section("embodiment")
    most = embodiment.max_width_m if embodiment else None
    for name in _streams_of(episode, WidthStream):
        path = f"streams/{name}/data"
        told: set[str] = set()
        for start, rows, valid in _valid_blocks(episode, name, "data"):
            usable = valid & np.isfinite(rows)
            low = usable & (rows < -_WIDTH_TOLERANCE_M)
            if low.any() and "low" not in told:
                told.add("low")
                row = int(low.argmax())
                yield problem("WIDTH-001", path, index=start + row, found=f"{rows[row]:.4g}")
            if most is None:
                continue
            high = usable & (rows > most + _WIDTH_TOLERANCE_M)
            if high.any() and "high" not in told:
                told.add("high")
                row = int(high.argmax())
                found = f"{rows[row]:.4g}"
                yield problem("WIDTH-002", path, index=start + row, expected=most, found=found)


@check("RAW-003")
def raw_modulus(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that wrapping counts stay below where they wrap."""
    for name, stream in episode.streams.items():
        if not isinstance(stream, PoseStream | WidthStream | WrenchStream):
            continue
        modulus = stream.raw.modulus if stream.raw else None
        if modulus is None:
            continue
        for start, rows, usable in _valid_blocks(episode, name, "raw"):
            flat = rows.reshape(len(rows), -1)
            wrong = usable & ((flat < 0) | (flat >= modulus)).any(axis=1)
            if wrong.any():
                row = int(wrong.argmax())
                beyond = flat[row][(flat[row] < 0) | (flat[row] >= modulus)]
                yield problem(
                    "RAW-003",
                    f"streams/{name}/raw",
                    index=start + row,
                    expected=modulus - 1,
                    found=beyond[0].item(),
                )
                break


@check("TACT-003")
def reference_frames(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the frames that a reference was made from are there."""
    for name, stream in episode.streams.items():
        count = episode.count(name)
        if not isinstance(stream, TactileStream) or stream.reference is None or count is None:
            continue
        for index, frame in enumerate(stream.reference.frames or []):
            if frame >= count:
                pointer = (*EXUMI, "streams", name, "reference", "frames", index)
                yield problem("TACT-003", ROOT, pointer=pointer, expected=count, found=frame)
