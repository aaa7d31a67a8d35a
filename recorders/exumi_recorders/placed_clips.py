"""What the clock of an attached clip says of the poses that the clip was placed by."""

import re

from exumi_data.model import Clock
from exumi_data.model.base import STREAM_NAME

__all__ = ["placed_by"]

# As `exumi_recorders.attach.writing` states it.
_PLACED_BY = re.compile(rf"exumi-(?:gyro|sweep)-match/.* against '({STREAM_NAME.strip('^$')})', ")


def placed_by(clock: Clock) -> str | None:
    """Return the pose stream that a clip was placed by, as the clip's clock says.

    The clip is in step with the poses as they were then: where their times change, so do its.

    Parameters
    ----------
    clock : Clock
        Of any stream.

    Returns
    -------
    str or None
        None where it was not placed by poses.
    """
    found = _PLACED_BY.search(clock.method or "")
    return None if found is None else found[1]
