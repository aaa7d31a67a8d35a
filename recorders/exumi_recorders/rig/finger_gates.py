"""Gates of tactile fingers: nothing touches them, and none is in another one's place."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from exumi_data.errors import DamagedDataError
from exumi_data.model.calibration import RIG_REFERENCE
from exumi_data.standard.rule_table import rules
from exumi_data.store import jpeg
from exumi_data.tactile import (
    ACTIVE_THRESHOLD,
    ActivityMeter,
    reference_image,
    resembled_finger,
    thumbnail,
    to_grey,
)
from exumi_recorders.contract import Files
from exumi_recorders.rig.gate import Gate
from exumi_recorders.rig.probing import ProbedStream

__all__ = ["decoded_frames", "finger_gates"]

Image = npt.NDArray[np.uint8]

_EXPECTED = f"active on less than {ACTIVE_THRESHOLD:.1%} of the image"
_OWN = "its own finger"
_CAPTURE = (
    "Record two seconds in which nothing is touched, then: exumi calibrate tactile EPISODE "
    "--stream {} --out FILE."
)


def finger_gates(
    streams: Sequence[ProbedStream], arrays: Mapping[str, npt.NDArray[np.generic]]
) -> list[Gate]:
    """Compare what tactile cameras show with the references of the rig's own fingers.

    Parameters
    ----------
    streams : sequence of ProbedStream
        Those that are not tactile are left out.
    arrays : mapping of str to ndarray
        The calibration's, by name of the item.
    """
    tactile = [stream for stream in streams if stream.port.kind == "tactile"]
    references = {
        name.removeprefix(RIG_REFERENCE): array
        for name, array in arrays.items()
        if name.startswith(RIG_REFERENCE) and _is_image(array)
    }
    images = {stream.name: decoded_frames(stream) for stream in tactile}
    return [
        gate
        for stream in tactile
        for gate in (
            _contact(stream, images[stream.name], references.get(stream.name)),
            _place(stream, images[stream.name], references),
        )
    ]


def _is_image(array: npt.NDArray[np.generic]) -> bool:
    return array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] in {1, 3}


def decoded_frames(stream: ProbedStream) -> list[Image]:
    """Return the frames of a camera that were kept, grey; damaged ones are left out."""
    size = stream.port.payload
    assert isinstance(size, Files)  # noqa: S101  # tactile cameras send files
    found = []
    for data in stream.frames:
        frame = np.empty((size.height, size.width, size.channels), np.uint8)
        try:
            jpeg.decode_into(data, frame)
        except DamagedDataError:
            continue
        found.append(to_grey(frame))
    return found


def _contact(
    stream: ProbedStream, images: list[Image], reference: npt.NDArray[np.generic] | None
) -> Gate:
    name, fix = "reference", _CAPTURE.format(stream.name)
    if reference is None:
        return Gate(name, stream.name, "warn", "none is in the calibration", _EXPECTED, fix)
    if not images:
        return Gate(name, stream.name, "skipped", "no frame came", _EXPECTED)
    if reference.shape[:2] != images[0].shape:
        height, width = reference.shape[:2]
        found = f"the reference is {width}x{height}"
        expected = f"{images[0].shape[1]}x{images[0].shape[0]}, as the frames are"
        return Gate(name, stream.name, "fail", found, expected, fix)
    meter = ActivityMeter(to_grey(np.asarray(reference, np.uint8)))
    # The hand may be at work: it is enough that nothing was touched at one moment.
    least = min(map(meter.measure, images))
    found = f"active on {least:.2%}"
    if least <= ACTIVE_THRESHOLD:
        return Gate(name, stream.name, "pass", found, _EXPECTED)
    fix = f"Let go of everything. If nothing is touched, light or gel have changed. {fix}"
    return Gate(name, stream.name, "fail", found, _EXPECTED, fix)


def _place(
    stream: ProbedStream,
    images: list[Image],
    references: Mapping[str, npt.NDArray[np.generic]],
) -> Gate:
    name = "left_right"
    if not images:
        return Gate(name, stream.name, "skipped", "no frame came", _OWN)
    fitting = {
        other: thumbnail(to_grey(np.asarray(reference, np.uint8)))
        for other, reference in references.items()
        if reference.shape[:2] == images[0].shape
    }
    if stream.name not in fitting or len(fitting) < 2:
        found = "no references of two fingers are in the calibration"
        return Gate(name, stream.name, "skipped", found, _OWN)
    limits = rules()["TACT-010"].limits
    nearest = resembled_finger(
        stream.name,
        reference_image([thumbnail(image) for image in images]),
        fitting,
        difference_ratio=limits["difference_ratio"],
        references_grey_levels=limits["references_grey_levels"],
    )
    if nearest is None:
        found = "the references look alike"
        return Gate(name, stream.name, "skipped", found, _OWN)
    if nearest == stream.name:
        return Gate(name, stream.name, "pass", _OWN, _OWN)
    fix = "The plugs are exchanged: exchange `device` of the two in the rig file, or the fingers."
    return Gate(name, stream.name, "fail", f"the finger {nearest}", _OWN, fix)
