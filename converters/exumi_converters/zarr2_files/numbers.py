"""Numbers of a store: read, turned into poses, and checked for those that are none."""

import numpy as np

from exumi_converters.zarr2_files.rows import Rows
from exumi_data.errors import SourceError
from exumi_data.geometry import axis_angle_to_quaternion, make_sign_continuous
from exumi_data.model import QualityNote
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["are_float32", "note_not_finite", "read_numbers", "to_poses"]

_MAX_ANGLE = 1e6  # beyond, a rotation of float32 is noise
_MAX_FLOAT32 = float(np.finfo(np.float32).max)


def read_numbers(writer: EpisodeWriter, rows: Rows, stream: str | None) -> np.ndarray:
    """Read rows; chunks that are not stored hold the fill value, which is said.

    Parameters
    ----------
    writer : EpisodeWriter
    rows : Rows
    stream : str or None
        That they become; None says nothing.

    Raises
    ------
    SourceError
        A chunk is damaged.
    """
    try:
        return rows.read()
    except SourceError:
        found = rows.read(fill=True)
    note = QualityNote(
        code="fill-value",
        message=f"{rows.meta.path} lacks chunks: in Zarr they hold its fill value, "
        f"{rows.meta.fill_value!r}, throughout",
        stream=stream,
    )
    if stream is not None and note not in writer.metadata.quality:
        writer.metadata.quality.append(note)
    return found


def to_poses(position: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn positions and rotation vectors into poses whose quaternions never change sides.

    Parameters
    ----------
    position, rotation : (n, 3) floating point

    Returns
    -------
    poses : (n, 7) float64
        NaN where a number is none.
    valid : (n,) bool
    """
    vectors = np.asarray(rotation, np.float64)
    with np.errstate(invalid="ignore"):
        small = np.abs(vectors) < _MAX_ANGLE
    valid = np.asarray((are_float32(position) & small).all(axis=1))
    poses = np.full((len(position), 7), np.nan)
    poses[valid, :3] = position[valid]
    poses[valid, 3:] = make_sign_continuous(axis_angle_to_quaternion(vectors[valid]))
    return poses, valid


def are_float32(values: np.ndarray) -> np.ndarray:
    """Return which numbers are finite, also as float32; of the shape of `values`."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(values) <= _MAX_FLOAT32)


def note_not_finite(writer: EpisodeWriter, stream: str, valid: np.ndarray) -> None:
    """Say how many samples are no numbers, if some are.

    Parameters
    ----------
    writer : EpisodeWriter
    stream : str
    valid : (n,) bool
    """
    if not valid.all():
        writer.metadata.quality.append(
            QualityNote(
                code="not-finite",
                message=f"{np.count_nonzero(~valid)} of {len(valid)} samples are no finite "
                "numbers: they are flagged invalid",
                stream=stream,
            )
        )
