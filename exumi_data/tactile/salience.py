"""Salient frames: those that differ most from the frame before."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exumi_data.tactile.images import UInt8Array, check_pair

__all__ = ["SALIENCE_METHOD", "difference_energy", "salient_frames"]

SALIENCE_METHOD = "octopi-salience/1"


def difference_energy(previous_grey: UInt8Array, grey: UInt8Array) -> int:
    """Sum the absolute differences of two successive frames.

    Parameters
    ----------
    previous_grey, grey
        (H, W) uint8, at native resolution.

    Returns
    -------
    int
        Sum over pixels of |grey - previous_grey|, grey levels.

    Raises
    ------
    ValueError
        If shapes or dtypes do not fit.
    """
    import cv2

    check_pair(grey, previous_grey)
    return int(cv2.norm(grey, previous_grey, cv2.NORM_L1))


def salient_frames(energy: npt.ArrayLike, k: int = 10) -> npt.NDArray[np.int64]:
    """Select the k frames with the largest frame difference; algorithm ``octopi-salience/1``.

    After Octopi (Yu et al., 2024, section on data processing), as its text says; the released
    code does something else.

    Parameters
    ----------
    energy
        (N,) `difference_energy` of each frame to the one before. The first frame has none: its
        entry is not read.
    k
        Number of frames wanted.

    Returns
    -------
    (min(k, N),) int64
        Frame indices in time order. Of equal frames the earlier is selected; frame 0 only where
        there are not enough others.

    Raises
    ------
    ValueError
        If the energies are not one-dimensional or k is negative.
    """
    energies = np.asarray(energy)
    if energies.ndim != 1:
        raise ValueError(f"energies must be of shape (N,), not {energies.shape}")
    if k < 0:
        raise ValueError(f"invalid number of frames {k}: it must not be negative")
    # Ascending order of the reversed array, read backwards: stable, and right for unsigned too.
    descending = energies.size - 1 - np.argsort(energies[:0:-1], kind="stable")[::-1]
    order = np.concatenate((descending, np.zeros(min(1, energies.size), np.int64)))
    return np.sort(order[:k]).astype(np.int64)
