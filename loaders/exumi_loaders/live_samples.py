"""Samples of live streams, checked as they arrive."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.store import jpeg
from exumi_loaders.policy_spec import PolicySpec, PolicyStreamSpec
from exumi_loaders.window_frames import as_channels

__all__ = ["checked_references", "checked_sample"]


def checked_references(
    spec: PolicySpec, references: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Check the references that were given, and return them as the policy is given them.

    Parameters
    ----------
    spec : PolicySpec
    references : mapping of str to (H, W, C) uint8

    Raises
    ------
    UsageError
        They are not those that the policy needs, or of another size.
    """
    wanted = [name for name, stream in spec.streams.items() if stream.reference]
    if set(references) != set(wanted):
        raise UsageError(
            f"references of {', '.join(references) or 'no stream'}, expected of "
            f"{', '.join(wanted) or 'none'}",
            fix="Take an image of each gel without contact before the policy starts.",
        )
    return {name: _frame(name, spec.streams[name], references[name]) for name in wanted}


def checked_sample(name: str, stream: PolicyStreamSpec, sample: Any) -> bytes | np.ndarray | None:
    """Return a sample as it is kept, or refuse it.

    Parameters
    ----------
    name : str
    stream : PolicyStreamSpec
    sample : bytes or array_like

    Returns
    -------
    bytes, ndarray or None
        A copy; None for a frame that is damaged.

    Raises
    ------
    UsageError
        It is no sample of this stream.
    """
    if stream.kind in ("pose", "width"):
        return _numbers(name, stream.kind, sample)
    if isinstance(sample, bytes | bytearray | memoryview):
        return _jpeg(name, stream, bytes(sample))
    return _frame(name, stream, np.asarray(sample))


def _numbers(name: str, kind: str, sample: Any) -> np.ndarray:
    # Types as in a recorded window: a width is float32 there.
    values = np.array(sample, dtype=np.float64 if kind == "pose" else np.float32)
    expected = (7,) if kind == "pose" else ()
    if values.shape != expected:
        raise UsageError(f"{name}: a {kind} of shape {values.shape}, expected {expected}")
    if not np.isfinite(values).all() or (kind == "pose" and not np.linalg.norm(values[3:]) > 1e-6):
        raise UsageError(f"{name}: {values.tolist()} is no {kind}")
    return values


def _jpeg(name: str, stream: PolicyStreamSpec, data: bytes) -> bytes | None:
    try:
        height, width, channels = jpeg.size_of(data)
    except DamagedDataError:
        return None  # a frame that was cut short on its way is no reason to stop
    if (height, width) != stream.shape[:2] or channels < stream.given[2]:
        raise _other_size(name, stream, (height, width, channels))
    return data


def _frame(name: str, stream: PolicyStreamSpec, frame: np.ndarray) -> np.ndarray:
    if frame.dtype != np.uint8:
        raise UsageError(f"{name}: a frame of {frame.dtype}, expected uint8")
    if frame.shape not in (stream.shape, stream.given):
        raise _other_size(name, stream, frame.shape)
    return np.array(as_channels(frame, stream.given[2]))


def _other_size(name: str, stream: PolicyStreamSpec, found: Iterable[int]) -> UsageError:
    return UsageError(
        f"{name}: a frame of {tuple(found)} (height, width, channels), the policy was trained on "
        f"{stream.shape}",
        fix="Make live frames in the way that those of the dataset were made.",
    )
