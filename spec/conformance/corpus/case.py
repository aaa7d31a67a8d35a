"""A case of the corpus: a store and what is to be found in it."""

import io
import stat
import zipfile
from dataclasses import dataclass, field
from typing import Any

from corpus.draft import Draft

__all__ = ["Case", "Finding", "as_zip", "case", "packed"]

EXUMI = "/attributes/exumi"


@dataclass(frozen=True)
class Finding:
    """A broken rule and its place."""

    code: str
    path: str
    pointer: str | None = None
    index: int | None = None
    episode: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as ``expected.json`` has it."""
        return {
            "code": self.code,
            "episode": self.episode,
            "path": self.path,
            "pointer": self.pointer,
            "index": self.index,
        }


@dataclass(frozen=True)
class Case:
    """One folder of the corpus.

    Attributes
    ----------
    name : str
        ``<rule or feature>__<defect>``.
    about : str
        One sentence.
    store : str
        ``store.zarr``, ``store.zarr.zip`` or ``dataset``.
    files : dict
        Path below `store` to bytes; of a zip, its bytes under the path "".
    findings : tuple of Finding
    draft : Draft or None
        What the files were made from, where it is known.
    """

    name: str
    about: str
    store: str
    files: dict[str, bytes]
    findings: tuple[Finding, ...] = field(default=())
    draft: Draft | None = None

    def output(self) -> dict[str, bytes]:
        """Return the files of the case's folder, without ``expected.json``."""
        return {f"{self.store}/{path}" if path else self.store: b for path, b in self.files.items()}


def case(name: str, about: str, draft: Draft | dict[str, bytes], *findings: Finding) -> Case:
    """Make a case of an episode's folder."""
    if isinstance(draft, Draft):
        return Case(name, about, "store.zarr", draft.files(), findings, draft)
    return Case(name, about, "store.zarr", draft, findings)


def packed(name: str, about: str, archive: bytes, *findings: Finding) -> Case:
    """Make a case of a packed episode."""
    return Case(name, about, "store.zarr.zip", {"": archive}, findings)


def packing_key(path: str) -> tuple[int, int, bytes]:
    """Return the place of a member: metadata first, breadth first."""
    if path.rpartition("/")[2] == "zarr.json":
        return (0, path.count("/"), path.encode())
    return (1, 0, path.encode())


def as_zip(
    files: dict[str, bytes] | list[tuple[str, bytes]],
    *,
    date: tuple[int, int, int, int, int, int] = (1980, 1, 1, 0, 0, 0),
    compressed: str | None = None,
    links: tuple[str, ...] = (),
) -> bytes:
    """Pack files as the standard says, but for what is asked otherwise.

    A list is packed in its own order.
    """
    buffer = io.BytesIO()
    members = files
    if isinstance(members, dict):
        members = sorted(members.items(), key=lambda item: packing_key(item[0]))
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for path, data in members:
            info = zipfile.ZipInfo(path, date)
            kind = stat.S_IFLNK if path in links else stat.S_IFREG
            info.external_attr = (kind | 0o644) << 16
            info.create_system = 3
            if path == compressed:
                info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)
    return buffer.getvalue()
