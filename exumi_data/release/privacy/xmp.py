"""XMP packets: XML that says where and by whom a picture was taken."""

import re
from collections.abc import Iterator

from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.passages import text_patches
from exumi_data.release.privacy.patches import Patch
from exumi_data.release.privacy.tags import Names

__all__ = ["xmp_patches"]

_TELLING: tuple[tuple[re.Pattern[bytes], Kind, str], ...] = (
    (
        re.compile(rb"GPS(?:Latitude|Longitude|Altitude)|geo:lat", re.IGNORECASE),
        "gps",
        "a position",
    ),
    (
        re.compile(rb"SerialNumber|InstanceID|DocumentID", re.IGNORECASE),
        "serial",
        "a serial number",
    ),
    (re.compile(rb"dc:creator|OwnerName|tiff:Artist", re.IGNORECASE), "operator", "a person"),
)


def xmp_patches(packet: bytes, start: int, names: Names | None = None) -> Iterator[Patch]:
    """Yield what in a packet may be private.

    Where it has fields for that, it is taken out whole, else only what its text says.

    Parameters
    ----------
    packet : bytes
    start : int
        Where it begins in the file.
    names : mapping of str to str, optional
        People whom the dataset names.
    """
    for pattern, kind, what in _TELLING:
        found = pattern.search(packet)
        if found:
            value = found[0].decode("latin-1")
            yield Patch(kind, start, b" " * len(packet), value, f"{what} in an XMP packet")
    yield from text_patches(packet, start, names or {})
