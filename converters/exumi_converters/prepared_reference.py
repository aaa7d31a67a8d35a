"""The reference of a tactile stream: the stored one, or one selected from its frames."""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from exumi_converters.prepared_stream import images_of_view
from exumi_converters.tactile_analysis import REFERENCE_FROM, estimated_note
from exumi_data.episode import StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.model import QualityNote, Reference, TactileStream
from exumi_data.tactile import (
    REFERENCE_METHOD,
    choose_reference,
    reference_image,
    thumbnail,
    to_grey,
)

__all__ = ["FoundReference", "find_reference"]


@dataclass(frozen=True, slots=True)
class FoundReference:
    """A reference image and how it was had.

    Attributes
    ----------
    image : (H, W, C) uint8 or None
    about : Reference or None
    note : QualityNote or None
        That it may hold contact.
    """

    image: np.ndarray | None
    about: Reference | None
    note: QualityNote | None = None


def find_reference(view: StreamView) -> FoundReference:
    """Return a stream's reference; where there is none, select frames as a conversion does.

    Parameters
    ----------
    view : StreamView

    Raises
    ------
    DamagedDataError
        The stored one is no image of the frames' size.
    """
    model = view.metadata
    if not isinstance(model, TactileStream):
        return FoundReference(None, None)
    if "reference" in model.arrays or not len(view):
        return FoundReference(_stored(view), model.reference)
    greys = islice(view.frames.iterate(grey=True), REFERENCE_FROM)
    choice = choose_reference([thumbnail(to_grey(grey)) for grey in greys])
    about = Reference(
        method=choice.method,
        frames=list(choice.frames),
        # An estimated reference may hold contact or not: that is not known.
        contact_free=True if choice.contact_free else None,
        algorithm=REFERENCE_METHOD,
    )
    note = None if choice.contact_free else estimated_note(view.name, choice)
    return FoundReference(reference_image(list(view.frames.read(choice.frames))), about, note)


def _stored(view: StreamView) -> np.ndarray | None:
    image, images = view.reference, images_of_view(view)
    size = images.height, images.width
    if image is not None and (
        image.dtype != np.uint8 or image.shape not in ((*size, 1), (*size, 3))
    ):
        raise DamagedDataError(
            f"the reference is {image.shape} {image.dtype}, the frames are {size}",
            where=repr(view),
        )
    return image
