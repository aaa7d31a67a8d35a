"""Ids and digests: the same source and settings give the same episode, on every machine."""

import hashlib
import json
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from exumi_converters.converter import SourceFile, SourceMembers
from exumi_data.errors import SourceError
from exumi_data.model import CONVENTION_UUID, InputFile
from exumi_data.model.base import Identifier
from exumi_data.store.digest import sha256_file

__all__ = ["digest_inputs", "episode_id", "relative_name", "settings_digest", "source_digest"]

_NAMESPACE = uuid.UUID(CONVENTION_UUID)
_NAME: TypeAdapter[str] = TypeAdapter(Identifier)


def episode_id(scheme: str, source_sha256: str, key: str) -> str:
    """Make an episode's id: UUIDv5 of the format's own namespace.

    Parameters
    ----------
    scheme : str
        Converter and version of its id scheme, such as ``octopi/1``.
    source_sha256 : str
    key : str
        Which part of the source.
    """
    return str(uuid.uuid5(_NAMESPACE, f"{scheme}\n{source_sha256}\n{key}"))


def settings_digest(settings: dict[str, Any]) -> str:
    """Return the sha-256 of JSON values, whatever the order of their keys."""
    text = json.dumps(
        settings, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return hashlib.sha256(text.encode()).hexdigest()


def _lines_digest(lines: list[str]) -> str:
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _digest(file: SourceFile) -> InputFile:
    try:
        _NAME.validate_python(file.name)
    except ValidationError:
        raise SourceError(
            "its name cannot be kept: it has more than 255 letters, several lines, a space at an "
            "end, or letters that are none",
            where=file.name,
            fix="Rename the file or its folder.",
        ) from None
    try:
        if file.members is not None:
            return _digest_members(file.name, file.members)
        if file.path.is_dir():
            return _digest_folder(file)
        return InputFile(
            name=file.name, sha256=sha256_file(file.path), bytes=file.path.stat().st_size
        )
    except OSError as error:
        raise SourceError(
            f"cannot be read ({error.strerror})",
            where=error.filename or file.path,
            fix="Check that it exists and that you may read it.",
        ) from None


def _digest_folder(file: SourceFile) -> InputFile:
    lines, total = [], 0
    for path in sorted(file.path.iterdir(), key=lambda p: p.name.encode()):
        if path.is_file():
            size = path.stat().st_size
            lines.append(f"{sha256_file(path)} {size} {path.name}\n")
            total += size
    return InputFile(name=f"{file.name}/", sha256=_lines_digest(lines), bytes=total)


def _digest_members(name: str, members: SourceMembers) -> InputFile:
    """Digest the part of an archive or folder that an episode is made from, as that of a folder."""
    digest, total = hashlib.sha256(), 0
    for member, content in members:
        sha256 = hashlib.sha256(content).hexdigest()
        digest.update(f"{sha256} {len(content)} {member}\n".encode())
        total += len(content)
    return InputFile(name=name, sha256=digest.hexdigest(), bytes=total)


def digest_inputs(files: Sequence[SourceFile]) -> list[InputFile]:
    r"""Return name, sha-256 and size of each input.

    That of a folder is over the lines ``sha256 size name\n`` of its files, sorted by the bytes of
    their names; that of members of an archive over their lines, in the order they are given in.

    Raises
    ------
    SourceError
        One cannot be read.
    """
    return [_digest(file) for file in files]


def source_digest(files: Sequence[SourceFile], inputs: Sequence[InputFile]) -> str:
    """Return the digest that identifies an episode's source.

    It is the sha-256 of the file that identifies it; of several, that over their lines.
    """
    chosen = [item for file, item in zip(files, inputs, strict=True) if file.identifies]
    if len(chosen) == 1:
        return chosen[0].sha256
    return _lines_digest([f"{item.sha256} {item.bytes} {item.name}\n" for item in chosen])


def relative_name(path: Path, root: Path) -> str:
    """Return a file's name within a source, ``/``-separated."""
    return path.relative_to(root).as_posix()
