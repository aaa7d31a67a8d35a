"""Which finger an image shows, told by the references of a rig's own fingers."""

import itertools
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

__all__ = ["pattern_difference", "resembled_finger"]

UInt8Array = npt.NDArray[np.uint8]

_SAME = 1e-9  # grey levels


def pattern_difference(image: UInt8Array, reference: UInt8Array) -> float:
    """Return the mean absolute difference of two images, whatever their mean level.

    Parameters
    ----------
    image, reference : (h, w) uint8

    Returns
    -------
    float
        Grey levels.
    """
    levels = image.astype(np.float32) - reference
    return float(np.abs(levels - np.median(levels)).mean())


def resembled_finger(
    name: str,
    image: UInt8Array,
    references: Mapping[str, UInt8Array],
    *,
    difference_ratio: float,
    references_grey_levels: float,
) -> str | None:
    """Return the finger whose reference an image resembles, as rule TACT-010 has it.

    Parameters
    ----------
    name : str
        The finger that the image is said to be of; one of `references`.
    image : (h, w) uint8
        A typical image, as small as a thumbnail.
    references : mapping of str to (h, w) uint8
        Two or more, of the same size.
    difference_ratio : float
        Another finger's reference has to differ from the image by less than this share of what
        its own differs by.
    references_grey_levels : float
        By how much references have to differ from each other to tell fingers apart.

    Returns
    -------
    str or None
        `name`, unless it is clearly another one's; None where the references look alike.
    """
    pairs = itertools.combinations(references.values(), 2)
    if min(pattern_difference(a, b) for a, b in pairs) < references_grey_levels:
        return None
    levels = {other: pattern_difference(image, r) for other, r in references.items()}
    nearest = min(levels, key=lambda other: (levels[other], other))
    is_other = levels[name] > _SAME and levels[nearest] < difference_ratio * levels[name]
    return nearest if is_other else name
