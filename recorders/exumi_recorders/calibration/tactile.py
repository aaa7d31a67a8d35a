"""Calibration of a tactile sensor: reference, rectification, depth, scale.

The reference is captured before work: an image of the rig's own finger that touches nothing. Frames
in contact, and frames that nothing tells whether they are, make none.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.errors import SourceError
from exumi_data.model.calibration import RECTIFICATION, RIG_REFERENCE
from exumi_data.model.description import CalibrationItem
from exumi_data.tactile import (
    PixelMap,
    choose_reference,
    read_ninedtact,
    reference_image,
    thumbnail,
    to_grey,
)
from exumi_recorders.calibration.files import Calibration, array_path

__all__ = [
    "DEPTH_TABLE",
    "SCALE",
    "captured_reference",
    "depth_table",
    "rectification",
    "scale",
    "selected_reference",
]

DEPTH_TABLE = "depth_table/"
"""An item of this name and a stream's: depth, mm, by how much darker a pixel is."""
SCALE = "mm_per_px/"
"""An item of this name and a stream's: mm per pixel across and down."""
CAPTURE_METHOD = "exumi-reference-capture/1"

UInt8Array = NDArray[np.uint8]

_FEWEST = 5
_MOST_KEPT = 31
_MOST_FRAMES = 20_000
# Grey levels: rest looks the same from frame to frame but for noise.
_MOST_CHANGE = 4
_MOST_CHANGED = 0.01
_MOST_TABLE_BYTES = 1 << 20


def captured_reference(frames: Iterable[UInt8Array], stream: str) -> Calibration:
    """Make the reference of a rig's finger from a recording in which nothing is touched.

    That nothing is touched is for the operator to say; that nothing changes is checked.

    Parameters
    ----------
    frames : iterable of (H, W, C) uint8
        Of one sensor. One is held at a time, but for a few dozen.
    stream : str

    Returns
    -------
    Calibration
        The item ``tactile_reference/<stream>`` with its array.

    Raises
    ------
    CalibrationRefusedError
        Too few frames, or something changes.
    """
    kept, small, count = _thinned(frames)
    _check_count(count, stream)
    _check_rest(small, stream)
    return _reference(kept, stream, f"nothing changes in {count} frames")


def selected_reference(frames: Sequence[UInt8Array], stream: str) -> Calibration:
    """Make the reference of a rig's finger from the quiet frames of a recording with contact.

    Parameters
    ----------
    frames : sequence of (H, W, C) uint8
        Of one sensor, in order of time; the first 20,000 are looked at.
    stream : str

    Returns
    -------
    Calibration
        The item ``tactile_reference/<stream>`` with its array.

    Raises
    ------
    CalibrationRefusedError
        Too few frames, or none that is known to be without contact.
    """
    count = min(len(frames), _MOST_FRAMES)
    _check_count(count, stream)
    choice = choose_reference([thumbnail(to_grey(frames[i])) for i in range(count)])
    if not choice.contact_free:
        raise CalibrationRefusedError(
            f"no frames without contact were found ({choice.reason})",
            where=stream,
            fix="Record two seconds in which the finger touches nothing.",
        )
    chosen = [frames[i] for i in choice.frames]
    return _reference(chosen, stream, f"selected among {count} frames: {choice.reason}")


def _check_count(count: int, stream: str) -> None:
    if count < _FEWEST:
        raise CalibrationRefusedError(
            f"{count} frames, needed are {_FEWEST}", where=stream, fix="Record for a second."
        )


def _reference(chosen: Sequence[UInt8Array], stream: str, how: str) -> Calibration:
    image = reference_image(chosen)
    name = RIG_REFERENCE + stream
    noise = float(np.mean([np.abs(frame.astype(np.int16) - image).mean() for frame in chosen]))
    item = CalibrationItem(
        value=None,
        residual=round(noise, 3),
        method=CAPTURE_METHOD,
        procedure=f"median of {len(chosen)} frames; {how}; residual: mean grey levels",
        array=array_path(name),
    )
    return Calibration({name: item}, {name: image})


def _thinned(
    frames: Iterable[UInt8Array],
) -> tuple[list[UInt8Array], list[UInt8Array], int]:
    """Keep up to a few dozen evenly spread frames without knowing how many there are."""
    kept: list[UInt8Array] = []
    small: list[UInt8Array] = []
    step, count = 1, 0
    for i, frame in enumerate(frames):
        count = i + 1
        if i % step:
            continue
        if kept and frame.shape != kept[0].shape:
            raise CalibrationRefusedError(f"frame {i} is {frame.shape}, not {kept[0].shape}")
        kept.append(frame.copy())
        small.append(thumbnail(to_grey(frame)))
        if len(kept) > 2 * _MOST_KEPT:
            kept, small = kept[::2], small[::2]
            step *= 2
    return kept, small, count


def _check_rest(small: Sequence[UInt8Array], stream: str) -> None:
    stack = np.stack(small).astype(np.int16)
    middle = np.median(stack, axis=0)
    changed = (np.abs(stack - middle) > _MOST_CHANGE).mean(axis=(1, 2))
    worst = int(changed.argmax())
    if changed[worst] > _MOST_CHANGED:
        raise CalibrationRefusedError(
            f"{changed[worst]:.0%} of the image changes: something touches, or the light does",
            where=stream,
            fix="Record it again without touching, with locked exposure; or, where quiet frames "
            "are to be selected among touches, say so (--has-contact).",
        )


def rectification(
    folder: Path, stream: str, *, crop_px: tuple[int, int] | None = None
) -> Calibration:
    """Import 9DTact's rectification maps: the item ``rectification/<stream>`` with its array.

    Parameters
    ----------
    folder : pathlib.Path
        9DTact's ``camera_calibration``.
    stream : str
    crop_px : (int, int), optional
        Rows and columns of the crop. Default: exUMI's.

    Returns
    -------
    Calibration
        `mm_per_px` is of the rectified image; 9DTact calls it ``pixel_per_mm``.

    Raises
    ------
    SourceError
        The files are missing or hold something else.
    """
    try:
        pixels = read_ninedtact(folder, **({} if crop_px is None else {"crop_px": crop_px}))
    except (ValueError, OSError) as error:
        raise SourceError(str(error), where=folder) from None
    return rectification_of_map(pixels, stream)


def rectification_of_map(pixels: PixelMap, stream: str) -> Calibration:
    """Return the item of a map with its array."""
    name = RECTIFICATION + stream
    value: dict[str, object] = {
        "centre_px": list(pixels.centre_px),
        "crop_px": list(pixels.crop_px),
    }
    if pixels.mm_per_px is not None:
        value["mm_per_px"] = list(pixels.mm_per_px)
    item = CalibrationItem(
        value=value,
        unit="px",
        method="9DTact camera calibration, a plate of dots",
        procedure="imported",
        array=array_path(name),
    )
    return Calibration({name: item}, {name: np.ascontiguousarray(pixels.index)})


def depth_table(path: Path, stream: str) -> Calibration:
    """Import 9DTact's table from darkening to depth: the item ``depth_table/<stream>``.

    Its first entry, that of no darkening, is set to 0: 9DTact's own is a leftover of how the table
    is filled, and negative in released ones. A table that does not ascend is refused.

    Parameters
    ----------
    path : pathlib.Path
        ``Pixel_to_Depth.npy``.
    stream : str

    Returns
    -------
    Calibration

    Raises
    ------
    SourceError
        The file is no such table.
    """
    try:
        if path.stat().st_size > _MOST_TABLE_BYTES:
            raise SourceError(f"larger than {_MOST_TABLE_BYTES:,} bytes", where=path)
        table = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise SourceError(f"no table of depths ({error})", where=path) from None
    usual = isinstance(table, np.ndarray) and table.ndim == 1 and 2 <= len(table) <= 256
    if not usual or table.dtype.kind != "f" or not np.isfinite(table).all():
        raise SourceError("no table of up to 256 depths", where=path)
    depths = np.concatenate([[0.0], table[1:].astype(np.float64)])
    if (np.diff(depths) < 0).any():
        at = 1 + int((np.diff(depths) < 0).argmax())
        raise SourceError(f"the depth falls at {at} grey levels", where=path)
    said = "imported from 9DTact; depth by grey levels that a pixel is darker than the reference"
    if table[0] != 0.0:
        said += f"; entry 0, {float(table[0]):.4g} in the file, set to 0"
    item = CalibrationItem(
        value={"depth_mm": [round(float(depth), 6) for depth in depths]},
        unit="mm",
        method="9DTact sensor calibration, a ball pressed in",
        procedure=said,
    )
    return Calibration({DEPTH_TABLE + stream: item})


def scale(mm_per_px: tuple[float, float], stream: str, *, method: str) -> Calibration:
    """Make the item ``mm_per_px/<stream>`` of a sensor whose frames are not rectified.

    Parameters
    ----------
    mm_per_px : (float, float)
        Across and down.
    stream : str
    method : str
        How it is known.

    Raises
    ------
    CalibrationRefusedError
        A number is not positive.
    """
    if not all(0 < value < 10 for value in mm_per_px):
        raise CalibrationRefusedError(f"a scale of {mm_per_px} mm per pixel", where=stream)
    item = CalibrationItem(value=list(mm_per_px), unit="mm/px", method=method)
    return Calibration({SCALE + stream: item})
