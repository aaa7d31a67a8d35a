"""What a model is not shown: modalities left out of all windows, or of some at random."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.draws import uniform
from exumi_loaders.options import one_of

__all__ = ["MASKS", "MODALITIES", "Mask", "Masks", "make_masks"]

Mask = Literal["none", "action", "rgb", "action+rgb", "tactile_history"]

MODALITIES = ("tactile_history", "rgb", "action", "proprioception")
"""What can be left out. ``rgb`` is all cameras; ``action`` includes what is between grippers."""

MASKS: dict[Mask, frozenset[str]] = {
    "none": frozenset(),
    # What the gripper did is told by its proprioception as well.
    "action": frozenset({"action", "proprioception"}),
    "rgb": frozenset({"rgb"}),
    "action+rgb": frozenset({"action", "proprioception", "rgb"}),
    "tactile_history": frozenset({"tactile_history"}),
}
"""The five inputs that exUMI compares, by what each leaves out."""

_PURPOSE = dict(zip(MODALITIES, range(16, 20), strict=True))  # purposes of draws, see draws.py


@dataclass(frozen=True)
class Masks:
    """Which modalities are left out of which windows.

    Attributes
    ----------
    always : frozenset of str
        Left out of all windows.
    dropout : dict of str to float
        Probability that each is left out of a window.
    """

    always: frozenset[str] = frozenset()
    dropout: dict[str, float] = field(default_factory=dict)

    def draw(self, modality: str, seed: int, epochs: np.ndarray, indices: np.ndarray) -> np.ndarray:
        """Decide for each window whether a modality is left out.

        Parameters
        ----------
        modality : str
        seed : int
        epochs, indices : (B,) int

        Returns
        -------
        (B,) bool
            A function of (seed, epoch, index) alone; modalities are independent of one another.
        """
        if modality in self.always:
            return np.ones(len(indices), dtype=bool)
        share = self.dropout.get(modality, 0.0)
        if not share:
            return np.zeros(len(indices), dtype=bool)
        return uniform(seed, epochs, indices, purpose=_PURPOSE[modality]) < share


def make_masks(mask: Mask, dropout: Mapping[str, float] | None, there: tuple[str, ...]) -> Masks:
    """Check the options of windows and make their masks.

    Parameters
    ----------
    mask : str
        One of `MASKS`.
    dropout : mapping of str to float, optional
        Probability by modality.
    there : tuple of str
        The modalities that the windows have.

    Returns
    -------
    Masks

    Raises
    ------
    UsageError
        An unknown mask or modality, one that the windows do not have, or no probability.
    """
    one_of("mask", mask, MASKS)
    for modality in mask.split("+") if mask != "none" else ():
        _check_there(f"mask={mask!r}", modality, there)
    for modality, share in (dropout or {}).items():
        if modality not in MODALITIES:
            raise UsageError(
                f"dropout of {modality!r}, which is no modality",
                fix=f"There are {', '.join(MODALITIES)}.",
            )
        _check_there("dropout", modality, there)
        if not 0 <= share <= 1:
            raise UsageError(f"dropout of {modality} is {share}, not in [0, 1]")
    return Masks(MASKS[mask], dict(dropout or {}))


def _check_there(option: str, modality: str, there: tuple[str, ...]) -> None:
    if modality not in there:
        raise UsageError(
            f"{option} leaves out {modality}, which these windows do not have",
            fix=f"They have {', '.join(there)}.",
        )
