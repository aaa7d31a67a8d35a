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
    paths = [rig.beside(name) for name in rig.about.calibration]
    missing = [path for path in paths if not path.is_file()]
    if missing:
        files = "the calibration file is" if len(missing) == 1 else "these calibration files are"
        raise UsageError(
            f"{files} not there",
            where=", ".join(map(str, missing)),
            fix="Calibrate with: exumi calibrate --help; or correct `calibration` in [rig].",
        )
    whole = merge({str(path): read_calibration(path) for path in paths})
    return Calibrated(whole.items, whole.arrays)
