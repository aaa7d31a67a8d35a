"""What holds for every document of the format, whichever it is."""

import re
from collections.abc import Iterator
from datetime import date
from typing import Any

from pydantic import BaseModel

from exumi_data.model.base import VERSION
from exumi_data.model.documents import KNOWN_FEATURES
from exumi_data.model.episode import FORMAT_VERSION
from exumi_validators.context import newer_minor
from exumi_validators.findings import problem
from exumi_validators.json_documents import LoadedDocument
from exumi_validators.model_problems import problems_of_model
from exumi_validators.report import Problem
from exumi_validators.schema_walk import extension_keys, unknown_keys

__all__ = [
    "DOCUMENT_RULES",
    "MODEL_RULES",
    "document_problems",
    "is_real_date",
    "is_spdx_expression",
    "licence_problems",
    "model_rule_problems",
    "undescribed_objects",
]

DOCUMENT_RULES = ("DOC-001", "DOC-002", "DOC-003", "DOC-004", "DOC-005", "ROOT-003")
MODEL_RULES = ("META-001", "META-002", "META-003", "META-004")

Pointer = tuple[int | str, ...]

_SPDX_ID = (
    r"(?:(?:DocumentRef-[A-Za-z0-9.-]+:)?LicenseRef-[A-Za-z0-9.-]+|[A-Za-z0-9][A-Za-z0-9.-]*\+?)"
)
_SPDX_TERM = rf"\(*{_SPDX_ID}(?: WITH [A-Za-z0-9.-]+)?\)*"
_SPDX = re.compile(rf"{_SPDX_TERM}(?: (?:AND|OR) {_SPDX_TERM})*")
_UNKNOWN_LICENCE = {
    "?", "n/a", "na", "none", "not specified", "not stated", "null", "other", "tbd", "todo",
    "unclear", "undefined", "unknown", "unlicensed", "unspecified",
}  # fmt: skip
_NO_LICENCE = "NONE"  # in capitals SPDX's word for: there is none
_DAY = re.compile(r"(\d{4})-(\d{2})-(\d{2})T")


def document_problems(
    loaded: LoadedDocument, document: dict[str, Any] | None, name: str, base: Pointer
) -> Iterator[Problem]:
    """Judge that a document can be read, and is of a format, version and features that are known.

    Parameters
    ----------
    loaded : LoadedDocument
        The file.
    document : dict or None
        The document in it.
    name : str
        The expected `format`.
    base : tuple
        Where in the file the document is.

    Yields
    ------
    Problem
        Of the rules `DOCUMENT_RULES`.
    """
    path = loaded.path
    if loaded.mistake is not None:
        yield problem("DOC-001", path, detail=loaded.mistake)
    for pointer in loaded.duplicates:
        yield problem("DOC-002", path, pointer=pointer, found=pointer[-1])
    if document is None:
        return
    if document.get("format") != name:
        yield problem(
            "DOC-003", path, pointer=(*base, "format"), expected=name, found=document.get("format")
        )
        return
    version = document.get("version")
    at = (*base, "version")
    major = FORMAT_VERSION.partition(".")[0]
    if not isinstance(version, str) or not re.fullmatch(VERSION, version):
        yield problem("DOC-004", path, pointer=at, expected=FORMAT_VERSION, found=version)
    elif newer_minor(version) is None:
        yield problem("DOC-005", path, pointer=at, expected=f"{major}.x", found=version)
    features = document.get("requires")
    for index, feature in enumerate(features if isinstance(features, list) else []):
        if str(feature) not in KNOWN_FEATURES:
            yield problem("ROOT-003", path, pointer=(*base, "requires", index), found=feature)


def model_rule_problems(
    name: str, model: type[BaseModel], document: dict[str, Any], path: str, base: Pointer
) -> Iterator[Problem]:
    """Judge a document by its model; unknown keys are found whatever else is wrong.

    Parameters
    ----------
    name : str
        Of the document: see `exumi_data.model.schema.DOCUMENTS`.
    model : type
        Its model.
    document : dict
        Of a known format and version.
    path : str
        File of the document.
    base : tuple
        Where in the file the document is.
    """
    yield from problems_of_model(model, document, path, base)
    for key in ("format", "version"):
        if key not in document:
            yield problem("META-001", path, pointer=(*base, key))
    code = "META-004" if newer_minor(document.get("version")) else "META-003"
    for pointer in unknown_keys(name, document):
        yield problem(code, path, pointer=(*base, *pointer), found=pointer[-1])


def undescribed_objects(
    name: str, document: dict[str, Any], path: str, base: Pointer
) -> Iterator[Problem]:
    """Judge that objects of third parties say where they are described.

    Parameters
    ----------
    name : str
        Of the document: see `exumi_data.model.schema.DOCUMENTS`.
    document : dict
    path : str
        File of the document.
    base : tuple
        Where in the file the document is.

    Yields
    ------
    Problem
        Of the rule EXT-002.
    """
    if not _has_key_of_third_party(document):  # walking along the schema costs more
        return
    for pointer in extension_keys(name, document):
        value: Any = document
        for part in pointer:
            value = value[part]
        in_own_stream = name == "episode" and len(pointer) > 2 and pointer[0] == "streams"
        if in_own_stream and ":" in str(document["streams"][pointer[1]].get("kind")):
            continue
        if isinstance(value, dict) and not isinstance(value.get("schema_url"), str):
            yield problem("EXT-002", path, pointer=(*base, *pointer), found=pointer[-1])


def _has_key_of_third_party(value: object) -> bool:
    if isinstance(value, dict):
        return any(":" in key or _has_key_of_third_party(item) for key, item in value.items())
    return isinstance(value, list) and any(_has_key_of_third_party(item) for item in value)


def licence_problems(licence: object, path: str, pointer: Pointer) -> Iterator[Problem]:
    """Judge how a licence is written.

    Parameters
    ----------
    licence : object
        As it stands in the document.
    path : str
    pointer : tuple

    Yields
    ------
    Problem
        Of the rules LIC-001 and LIC-002.
    """
    if not isinstance(licence, str):
        return
    if licence != _NO_LICENCE and licence.strip().lower() in _UNKNOWN_LICENCE:
        yield problem("LIC-001", path, pointer=pointer, found=licence)
    elif not is_spdx_expression(licence):
        yield problem("LIC-002", path, pointer=pointer, found=licence)


def is_spdx_expression(licence: str) -> bool:
    """Whether a text has the form of an SPDX licence expression (not whether its ids exist).

    Parameters
    ----------
    licence : str
    """
    # Expressions are short; the bound keeps the pattern from working on a book.
    if len(licence) > 1000 or licence.count("(") != licence.count(")"):
        return False
    return _SPDX.fullmatch(licence) is not None


def is_real_date(timestamp: object) -> bool:
    """Whether the day of an RFC 3339 timestamp is in the calendar; True for what is none.

    Parameters
    ----------
    timestamp : object
    """
    day = _DAY.match(timestamp) if isinstance(timestamp, str) else None
    if day is None:
        return True
    try:
        date(*(int(part) for part in day.groups()))
    except ValueError:
        return False
    return True
