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
        the name of its child frame; of any other stream those whose name begins or ends with the
        stream's, such as ``rgb_intrinsics`` and ``T_gripper_rgb``.

    Returns
    -------
    list of str
        Sorted names.
    """
    model = metadata.streams[stream]
    if isinstance(model, PoseStream):
        wanted = {model.frames.child, model.raw.transform if model.raw else None}
        return sorted(name for name in metadata.calibration if name in wanted)
    others = [name for name in metadata.streams if name.startswith(f"{stream}_")]
    return sorted(
        name
        for name in metadata.calibration
        if not name.startswith(_OWN_REFERENCE)
        and (name.startswith(f"{stream}_") or name.endswith(f"_{stream}"))
        and not name.startswith(tuple(others))
    )


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
