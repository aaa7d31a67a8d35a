"""The image of a tactile stream without contact.

It is of a few quiet frames of the episode; or was taken before the session's first episode; or is
that of the rig's calibration: the newest there is.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.errors import ExumiError
from exumi_data.model.calibration import RIG_REFERENCE
from exumi_data.model.description import CalibrationItem
from exumi_data.store import jpeg
from exumi_recorders.finalise.context import Context

__all__ = ["NOTHING_TOUCHED", "SESSION_REFERENCE", "ReferenceFrames", "set_reference"]

SESSION_REFERENCE = "session_reference/"
"""An item of this name and a stream's comes with the image that was taken before the session.

It is not the rig's: nobody may tell fingers apart by it. In the episode the image is the stream's
`reference`, and the item says when and how it was taken.
"""
NOTHING_TOUCHED = "nothing_touched"
"""In its value: whether the operator said so."""

_MOST = 9


class ReferenceFrames:
    """Keeps a few frames of a time at which the operator said that nothing was touched.

    Parameters
    ----------
    from_ns, until_ns : int
        Host times.
    """

    def __init__(self, from_ns: int, until_ns: int) -> None:
        self._from_ns = from_ns
        self._until_ns = until_ns
        self._kept: list[tuple[int, bytes]] = []

    @classmethod
    def wanted(cls, kind: str, stream: str, context: Context) -> "ReferenceFrames | None":
        """Return one where the journal says when the reference of a tactile stream was captured.

        Parameters
        ----------
        kind, stream : str
        context : Context
        """
        times = context.events.references.get(stream)
        return cls(*times) if kind == "tactile" and times is not None else None

    def take(self, first: int, time_host: npt.NDArray[np.int64], files: list[bytes]) -> None:
        """Look through some frames.

        Parameters
        ----------
        first : int
            Index of the first of them.
        time_host : (N,) int64
        files : list of bytes
        """
        quiet = (time_host >= self._from_ns) & (time_host <= self._until_ns)
        for index in np.flatnonzero(quiet).tolist():
            if len(self._kept) == _MOST:
                return
            self._kept.append((first + index, files[index]))

    def image(self, size: tuple[int, int, int]) -> tuple[np.ndarray, list[int]] | None:
        """Return the median of the frames, and which they are; None where none decodes.

        Parameters
        ----------
        size : (int, int, int)
            Height, width, channels.
        """
        decoded, indices = [], []
        for index, file in self._kept:
            out = np.empty(size, np.uint8)
            try:
                jpeg.decode_into(file, out)
            except ExumiError:
                continue
            decoded.append(out)
            indices.append(index)
        if not decoded:
            return None
        return np.median(np.stack(decoded), axis=0).astype(np.uint8), indices


def set_reference(
    out: Any, stream: str, context: Context, captured: ReferenceFrames | None
) -> None:
    """Give a tactile stream its reference, where there is one.

    Parameters
    ----------
    out : EncodedStreamWriter
    stream : str
    context : Context
    captured : ReferenceFrames, optional
        They are newer than the calibration, and come first.
    """
    if out.model.kind != "tactile":
        return
    images = out.model.images
    size = (images.height, images.width, images.channels)
    found = None if captured is None else captured.image(size)
    if found is not None:
        out.set_reference(found[0], method="captured", frames=found[1], contact_free=True)
        return
    for name in (f"{SESSION_REFERENCE}{stream}", f"{RIG_REFERENCE}{stream}"):
        if _set_calibrated(out, name, size, context, stream):
            return


def _set_calibrated(
    out: Any, name: str, size: tuple[int, int, int], context: Context, stream: str
) -> bool:
    """Take the image of a calibration item; return whether that was possible."""
    image = context.arrays.get(name) if name in context.calibration else None
    if image is None:
        return False
    if image.dtype == np.uint8 and image.shape in ((*size[:2], 1), (*size[:2], 3)):
        known = not name.startswith(SESSION_REFERENCE) or _is_confirmed(context.calibration[name])
        out.set_reference(np.array(image), method="captured", contact_free=True if known else None)
        return True
    context.note(
        "reference-not-used",
        f"the calibration {name!r} is {image.shape} {image.dtype}, the frames are {size}",
        stream,
    )
    return False


def _is_confirmed(item: CalibrationItem) -> bool:
    return isinstance(item.value, dict) and item.value.get(NOTHING_TOUCHED) is True
