"""Arrays that are attached as ``.npy``: nothing is believed but the bytes that are there."""

import io
import math

import numpy as np

from exumi_converters.mcap_files.records import AttachedFile
from exumi_data.errors import SourceError

__all__ = ["read_array"]


def read_array(attached: AttachedFile) -> np.ndarray:
    """Read an attached array.

    Parameters
    ----------
    attached : AttachedFile

    Raises
    ------
    SourceError
        It is no plain array of numbers, or not as large as it says. Pickles are not loaded.
    LimitError
        It has more than 256 MiB.
    """
    raw = attached.read()
    try:
        return _array(raw)
    except Exception as error:  # noqa: BLE001  # numpy's reader of headers lets all sorts through
        short = str(error).split("\n")[0][:200]
        raise SourceError(
            f"the attachment {attached.name} is no plain array ({short})", where=attached.path
        ) from None


def _array(raw: bytes) -> np.ndarray:
    file = io.BytesIO(raw)
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in read:
        msg = f"version {version} of the format"
        raise ValueError(msg)
    shape, by_columns, dtype = read[version](file)
    if dtype.kind not in "biuf":
        msg = f"it holds {dtype}"
        raise ValueError(msg)
    data = raw[file.tell() :]
    if math.prod(shape) * dtype.itemsize != len(data):
        msg = f"{shape} of {dtype} is not {len(data)} bytes"
        raise ValueError(msg)
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
