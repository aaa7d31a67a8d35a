"""The calibration files that a rig file names, as one."""

from exumi_data.errors import UsageError
from exumi_recorders.calibration.files import merge, read_calibration
from exumi_recorders.rig.model import Rig
from exumi_recorders.session.plan import Calibrated

__all__ = ["read_calibrations"]


def read_calibrations(rig: Rig) -> Calibrated:
    """Read all calibration files of a rig.

    Parameters
    ----------
    rig : Rig

    Raises
    ------
    UsageError
        A file is missing, or two say different things of one item.
    MetadataError
        A file is wrong.
    DamagedDataError
        Its arrays are not those that belong to it.
    """
    found = {}
    for name in rig.about.calibration:
        path = rig.beside(name)
        if not path.is_file():
            raise UsageError(
                "the calibration file is not there",
                where=path,
                fix="Calibrate with: exumi calibrate --help; or take it out of the rig file.",
            )
        found[str(path)] = read_calibration(path)
    whole = merge(found)
    return Calibrated(whole.items, whole.arrays)
