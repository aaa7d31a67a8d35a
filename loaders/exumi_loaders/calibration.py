"""Digests of what is calibrated about a stream: whether two rigs mean the same by its numbers."""

import hashlib
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from exumi_data.episode import Episode
from exumi_data.errors import UsageError
from exumi_data.model import EpisodeMetadata, PoseStream
from exumi_data.store.shards import open_array

__all__ = ["calibration_digest", "calibration_items"]

_OWN_REFERENCE = "tactile_reference/"  # an image of each gel, not a calibration of the rig


def calibration_items(metadata: EpisodeMetadata, stream: str) -> list[str]:
    """List the calibration items that a stream's numbers depend on.

    Parameters
    ----------
    metadata : EpisodeMetadata
    stream : str
        Of a pose stream these are the item that leads from ``raw`` to ``data`` and the one with
        the name of its child frame. Of any other stream they are those named ``<what>/<stream>``,
        such as ``intrinsics/rgb`` (the standard's own items), and those that begin or end with the
        stream's name, such as ``T_gripper_rgb`` and ``width_encoder``.

    Returns
    -------
    list of str
        Sorted names.
    """
    model = metadata.streams[stream]
    if isinstance(model, PoseStream):
        wanted = {model.frames.child, model.raw.transform if model.raw else None}
        return sorted(name for name in metadata.calibration if name in wanted)
    others = tuple(name for name in metadata.streams if name.startswith(f"{stream}_"))
    return sorted(
        name
        for name in metadata.calibration
        if _is_of(name, stream) and not name.startswith(others)
    )


def _is_of(name: str, stream: str) -> bool:
    """Return whether a calibration item is of a stream, by its name."""
    if "/" in name:  # the stream's whole name: intrinsics/left_rgb is not of rgb
        return name.partition("/")[2] == stream and not name.startswith(_OWN_REFERENCE)
    return name.startswith(f"{stream}_") or name.endswith(f"_{stream}")


def calibration_digest(rig: Episode | EpisodeMetadata, stream: str) -> str:
    """Return a digest of the values and units of a stream's calibration.

    When and how it was measured does not count.

    Parameters
    ----------
    rig : Episode or EpisodeMetadata
    stream : str

    Returns
    -------
    str
        SHA-256 in hexadecimal; empty if there are no such items.

    Raises
    ------
    UsageError
        An item is an array, and `rig` is only metadata.
    """
    metadata = rig.metadata if isinstance(rig, Episode) else rig
    names = calibration_items(metadata, stream)
    if not names:
        return ""
    content = [[name, *_content(rig, metadata, name)] for name in names]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _content(rig: Episode | EpisodeMetadata, metadata: EpisodeMetadata, name: str) -> Iterator[Any]:
    item = metadata.calibration[name]
    yield item.value
    yield item.unit
    if item.array is None:
        return
    if not isinstance(rig, Episode):
        raise UsageError(
            f"the calibration {name!r} is an array, which metadata alone does not hold",
            fix="Describe the rig by an opened episode.",
        )
    array = np.ascontiguousarray(open_array(rig.store, item.array).read())
    yield [str(array.dtype), list(array.shape), hashlib.sha256(array.tobytes()).hexdigest()]
