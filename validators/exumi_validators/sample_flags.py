"""Which samples bear a flag: the one place where bits are looked up."""

import numpy as np
import numpy.typing as npt

from exumi_data.standard import flags

__all__ = ["flagged"]


def flagged(bits: np.ndarray, *names: str) -> npt.NDArray[np.bool_]:
    """Find the samples that have one of some flags.

    Parameters
    ----------
    bits : (N,) uint32
        The array ``flags`` of a stream.
    *names : str
        Of flags: `invalid` for values that no rule judges, and `out_of_range` besides where the
        way from sample to sample is judged.

    Returns
    -------
    (N,) bool
    """
    mask = np.uint32(sum(flags()[name].mask for name in set(names)))
    return np.asarray((bits & mask) != 0)
