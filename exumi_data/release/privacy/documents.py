"""JSON documents: what in them may be private, and the same documents without it."""

import hashlib
import hmac
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.errors import UsageError
from exumi_data.release.privacy.kinds import Kind, Take, check_kinds, shortened
from exumi_data.release.privacy.structure import fitted, is_name_chosen, role_of, vocabulary
from exumi_data.release.privacy.text import GONE, account_names, matches_in

__all__ = ["Removal", "people_named", "private_names", "without_private_fields"]

_NAMED: dict[str, Kind] = {
    "operator": "operator",
    "operators": "operator",
    "annotator": "operator",
    "annotators": "operator",
    "collected_by": "operator",
    "recorded_by": "operator",
    "site": "site",
    "hub": "host",
    "host": "host",
    "hostname": "host",
    "computer": "host",
    "machine": "host",
    "user": "user",
    "username": "user",
    "login": "user",
    "email": "email",
    "gps": "gps",
    "gps_track": "gps",
    "lat": "gps",
    "lon": "gps",
    "lng": "gps",
    "latitude": "gps",
    "longitude": "gps",
    "gpslatitude": "gps",
    "gpslongitude": "gps",
    "geolocation": "gps",
}
_SERIAL = re.compile(r"(?:.*_)?(?:serials?|serial_?numbers?|serial_?no|mac_address)", re.IGNORECASE)
_WHY: dict[Kind, str] = {
    "operator": "who collected it; the standard asks for a pseudonym",
    "site": "where it was collected",
    "serial": "it names one device",
    "host": "it names one computer",
    "user": "it names an account",
    "email": "an e-mail address",
    "gps": "a position on earth",
}
# Shorter ones are found everywhere.
_SHORTEST: dict[Kind, int] = {"operator": 3, "user": 3, "site": 5, "serial": 5, "host": 5}
_PSEUDONYM = re.compile(r"(?:operator|site|serial|host|user)-[0-9a-f]{12}")
_LEAST_KEY = 16
_DEEPEST = 64
_WHOLE: tuple[Kind, ...] = ("gps", "operator")  # whatever they are made of
_PEOPLE: tuple[Kind, ...] = ("operator", "user")
# Whoever is named there wants to be.
_PUBLIC = ("/authors", "/citation")


@dataclass(frozen=True, slots=True)
class Removal:
    """What is taken out.

    A name without a key is taken away. With a key it becomes a pseudonym: the same name the same
    one, in every release with that key; who does not have the key cannot find out by trying names.

    Attributes
    ----------
    kinds : frozenset of str
    key : bytes or None
        A secret of at least 16 bytes; it is no part of the dataset.
    names : mapping of str to str
        Words that are private wherever the dataset has them, and their kinds: a person whom one
        document names as its operator is often named in the text of another.
    """

    kinds: frozenset[Kind]
    key: bytes | None = None
    names: Mapping[str, Kind] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_kinds(self.kinds)
        if self.key is not None and len(self.key) < _LEAST_KEY:
            raise UsageError(
                f"a key of {len(self.key)} bytes", fix=f"Give one of {_LEAST_KEY} or more."
            )

    def pseudonym(self, kind: Kind, value: object) -> str | None:
        """Return what stands for a name; None where it is taken away."""
        if self.key is None or not isinstance(value, str) or kind in ("email", "gps"):
            return None
        code = hmac.new(self.key, f"{kind}\0{value}".encode(), hashlib.sha256).hexdigest()
        return f"{kind}-{code[:12]}"

    def cleaned(self, text: str) -> str:
        """Return a text without what is taken out, line breaks and all else as they were."""
        parts, end = [], 0
        for match in matches_in(text, self.names, self.kinds):
            parts += [text[end : match.start], match.instead]
            end = match.stop
        return "".join([*parts, text[end:]])


def without_private_fields(
    document: Any, where: str, take: Take, removal: Removal | None = None
) -> Any:
    """Return a JSON document without what is taken; a document of which nothing is, is the same.

    Parameters
    ----------
    document : JSON value
    where : str
        The document's name.
    take : callable
        Told of each find.
    removal : Removal, optional
        Makes the pseudonyms.

    Returns
    -------
    JSON value
    """
    made = _Walk(document, where, take, removal or Removal(frozenset()), private_names(document))
    return made.value(document, "", 0)


def people_named(document: Any) -> dict[str, Kind]:
    """Return the people whom a document names in fields that are for it, and their accounts.

    Parameters
    ----------
    document : JSON value

    Returns
    -------
    dict of str to str
        Words, and the kind of each.
    """
    return {name: kind for name, kind in private_names(document).items() if kind in _PEOPLE}


def private_names(document: Any) -> dict[str, Kind]:
    """Return the words that are private wherever the document, or what it speaks of, has them.

    Parameters
    ----------
    document : JSON value

    Returns
    -------
    dict of str to str
        Words, and the kind of each.
    """
    found: dict[str, Kind] = {}
    for key, value in _strings(document, None, 0):
        kind = _kind_of_key(key)
        is_long = kind in _SHORTEST and len(value) >= _SHORTEST[kind]
        is_told = not _PSEUDONYM.fullmatch(value) and value.casefold() not in vocabulary()
        if kind is not None and is_long and is_told:
            found[value] = kind
        for name in account_names(value) - vocabulary():
            found.setdefault(name, "user")
    return found


def _strings(value: Any, key: str | None, depth: int) -> Iterator[tuple[str | None, str]]:
    if isinstance(value, str):
        yield key, value
    elif depth < _DEEPEST and isinstance(value, dict):
        for name, item in value.items():
            yield from _strings(item, name, depth + 1)
    elif depth < _DEEPEST and isinstance(value, list):
        for item in value:
            yield from _strings(item, key, depth + 1)


@lru_cache(maxsize=1024)
def _kind_of_key(key: str | None) -> Kind | None:
    if key is None:
        return None
    plain = key.rpartition(":")[2].lower()  # also of third parties
    return "serial" if _SERIAL.fullmatch(plain) else _NAMED.get(plain)


@dataclass(frozen=True, slots=True)
class _Walk:
    document: Any
    where: str
    take: Take
    removal: Removal
    names: dict[str, Kind]

    def value(self, value: Any, pointer: str, depth: int) -> Any:
        if isinstance(value, str):
            return self._text(value, pointer)
        if depth >= _DEEPEST:
            return value
        if isinstance(value, list):
            return [self.value(v, f"{pointer}/{i}", depth + 1) for i, v in enumerate(value)]
        return self._fields(value, pointer, depth) if isinstance(value, dict) else value

    def _fields(self, fields: dict[str, Any], pointer: str, depth: int) -> dict[str, Any]:
        made: dict[str, Any] = {}
        for key, value in fields.items():
            place = f"{pointer}/{key.replace('~', '~0').replace('/', '~1')}"
            kind = _kind_of_key(key)
            if kind is not None and is_name_chosen(self.document, place):
                if kind == "gps":
                    self._stays(kind, place, key, "a thing of this name may hold positions")
                kind = None
            if kind is not None and (kind in _WHOLE or not _has_fields(value)):
                if not _is_said(value):
                    made[key] = value
                    continue
                if not self._taken(kind, place, value, _WHY[kind]):
                    made[key] = value
                elif (instead := self.removal.pseudonym(kind, value)) is not None:
                    made[key] = instead
                continue
            name = self._text(key, place, is_key=True)
            name = key if name == key else _free(name, made, fields)
            made[name] = self.value(value, place, depth + 1)
        return made

    def _text(self, text: str, pointer: str, *, is_key: bool = False) -> str:
        is_public = self.where == DATASET_DOCUMENT and pointer.startswith(_PUBLIC)
        names = self.names if is_public else {**self.removal.names, **self.names}
        found = matches_in(text, names, self.removal.kinds or None)
        role = role_of(self.document, pointer, is_key=is_key) if found else "fixed"
        if role == "fixed":
            return text
        parts, end = [], 0
        for match in found:
            value = text[match.start : match.stop]
            if role == "id":
                self._stays(match.kind, pointer, value, f"{match.why} in an id, which has to stay")
            elif self._taken(match.kind, pointer, value, match.why):
                parts += [text[end : match.start], match.instead]
                end = match.stop
        left = "".join([*parts, text[end:]])
        return (fitted(left) if parts and role == "name" else left) or (GONE if text else text)

    def _taken(self, kind: Kind, pointer: str, value: object, why: str) -> bool:
        return self.take(kind, f"{self.where}#{pointer}", shortened(value), why)

    def _stays(self, kind: Kind, pointer: str, value: object, why: str) -> None:
        self.take(kind, f"{self.where}#{pointer}", shortened(value), why, removable=False)


def _free(name: str, *taken: dict[str, Any]) -> str:
    """Return a name with a number where another has it: two that are taken out look alike."""
    found, number = name, 1
    while any(found in one for one in taken):
        number += 1
        found = f"{name}-{number}"
    return found


def _has_fields(value: Any) -> bool:
    """Whether a value is made of others that have to be looked at one by one."""
    if isinstance(value, list):
        return any(isinstance(item, dict | list) for item in value)
    return isinstance(value, dict)


def _is_said(value: Any) -> bool:
    """Whether a named field says something: no flag, and none of our own pseudonyms."""
    if value is None or isinstance(value, bool) or value in ("", [], {}):
        return False
    return not (isinstance(value, str) and _PSEUDONYM.fullmatch(value))
