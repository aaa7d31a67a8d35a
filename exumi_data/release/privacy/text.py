"""What in a text may be private: paths, addresses, names of computers, positions."""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.names import named_in
from exumi_data.release.privacy.positions import positions_in

__all__ = ["GONE", "Match", "account_names", "matches_in"]

GONE = "removed"
"""What stands where something was taken out."""

_ROOTS = (
    "bin|cluster|data|datasets|etc|export|gpfs|home|lustre|media|mnt|net|nfs|opt|private|proc|proj"
    "|projects|root|run|scratch|srv|storage|sys|tmp|users|usr|Users|var|Volumes|work|workspace"
)
_PART = r"[^\s/\\\"'`<>|:;,*?()\[\]{}]+"
# Not after a letter, a dot or another slash: not m/s, not ../x, not https://x.
_START = r"(?<![\w.:/\\~$-])"
_POSIX = re.compile(
    rf"{_START}(?:file://)?(?:~[\w-]*(?:/{_PART})+/?|/(?:{_ROOTS})(?:/{_PART})+/?"
    rf"|/(?:{_ROOTS})/?(?![\w/])|/{_PART}/{_PART}(?:/{_PART})+/?)"
)
_WHOLE = re.compile(rf"(?:file://)?(?:~[\w-]*|/(?:{_ROOTS}))(?:/[^\n]*)?")
_WINDOWS = re.compile(r"(?<!\w)(?:[A-Za-z]:\\|[A-Z]:/)[^\s\"'<>|*?]*|\\\\[\w.-]+\\[^\s\"'<>|*?]+")
_WHOLE_WINDOWS = re.compile(r"[A-Za-z]:[\\/][^\n]*|\\\\[\w.-]+\\[^\n]*")
_DEVICE = re.compile(rf"/dev/(?:serial|v4l|snd|input|disk)/by-(?:id|path|uuid)/{_PART}")
_DEV = re.compile(r"/dev(?:/.*)?", re.DOTALL)
_HOMES = "home|Users"
_HOME = re.compile(rf"(?:/(?:{_HOMES})/|\\Users\\)([^\s/\\\"']+)")
_HOME_ALONE = re.compile(
    rf"(?:file://)?/(?:{_HOMES})/[^/]+/?|[A-Za-z]:[\\/]Users[\\/][^/\\]+[\\/]?|~[\w-]*/?"
)
_EMAIL = re.compile(r"(?<![\w.+-])(?!git@)[\w.+-]+@[A-Za-z0-9-]+(?:\.[A-Za-z0-9-]+)*\.[A-Za-z]{2,}")
_REMOTE = re.compile(r"(?<![\w.@])[A-Za-z_][\w.-]*@[A-Za-z][\w.-]*(?=:)")
_BYTE = r"(?:25[0-5]|2[0-4]\d|1?\d?\d)"
_IPV4 = re.compile(rf"(?<![\w.])(?:{_BYTE}\.){{3}}{_BYTE}(?![\w.])")
_NOBODY = re.compile(r"(?:0|127|255)\.")
_LOCAL_NAME = re.compile(
    r"(?<![\w.-])[A-Za-z0-9][\w-]*\.(?:local|lan|internal|intranet|localdomain|corp)(?![\w-])"
)
_MAC = re.compile(r"(?<![\w:-])(?:[0-9A-Fa-f]{2}:){5}[0-9A-Fa-f]{2}(?![\w:-])")
# None of the patterns is found where none of these is.
_TELLING = re.compile(r"[/\\@~:+]|\.[\w]|\d")
_REMEMBERED = 400
_PLAIN: tuple[tuple[re.Pattern[str], Kind, str], ...] = (
    (_EMAIL, "email", "an e-mail address"),
    (_REMOTE, "host", "an account on another computer"),
    (_IPV4, "host", "an address of a computer"),
    (_LOCAL_NAME, "host", "a computer of a local network"),
    (_MAC, "serial", "a network device's own address"),
)
# Accounts that everybody has.
_COMMON = frozenset(
    [
        "admin",
        "data",
        "guest",
        "lab",
        "pi",
        "public",
        "robot",
        "root",
        "runner",
        "shared",
        "ubuntu",
        "user",
        "work",
    ]
)


@dataclass(frozen=True, slots=True)
class Match:
    """A part of a text that may be private.

    Attributes
    ----------
    kind : str
    start, stop : int
    instead : str
        What can stand there.
    why : str
    """

    kind: Kind
    start: int
    stop: int
    instead: str
    why: str


def matches_in(
    text: str,
    names: Mapping[str, Kind] | None = None,
    kinds: Collection[Kind] | None = None,
) -> list[Match]:
    """List what in a text may be private, in order and without overlaps.

    Parameters
    ----------
    text : str
    names : mapping of str to str, optional
        Words that are private wherever they stand, and their kinds.
    kinds : collection of str, optional
        Only of these: a path that is kept must not keep the name in it. Default: all.

    Returns
    -------
    list of Match
    """
    every = list(_plain(text) if len(text) <= _REMEMBERED else _patterns(text))
    named = list(named_in(text, names or {}))
    every += [Match(kind, start, stop, GONE, why) for start, stop, kind, why in named]
    if kinds is not None:
        every = [match for match in every if match.kind in kinds]
    if named:
        every = [_without_names(match, names or {}, kinds) for match in every]
    found: list[Match] = []
    taken = -1
    for match in sorted(every, key=lambda match: (match.start, -match.stop)):
        if match.start >= taken:
            found.append(match)
            taken = match.stop
    return found


def _without_names(
    match: Match, names: Mapping[str, Kind], kinds: Collection[Kind] | None
) -> Match:
    """Return a match of a path, the last part of which stays, with no name in that."""
    if match.kind != "path" or match.instead == GONE:
        return match
    parts, end = [], 0
    for start, stop, kind, _ in sorted(named_in(match.instead, names)):
        if start >= end and (kinds is None or kind in kinds):
            parts += [match.instead[end:start], GONE]
            end = stop
    return replace(match, instead="".join([*parts, match.instead[end:]]))


def account_names(text: str) -> set[str]:
    """Return the names of accounts that the home folders in a text tell.

    Parameters
    ----------
    text : str
    """
    names = set(_HOME.findall(text))
    return {name for name in names if len(name) > 2 and name.lower() not in _COMMON}


@lru_cache(maxsize=4096)  # episodes of a dataset say much the same
def _plain(text: str) -> tuple[Match, ...]:
    return tuple(_patterns(text)) if _TELLING.search(text) else ()


def _patterns(text: str) -> Iterator[Match]:
    yield from _paths(text)
    for pattern, kind, why in _PLAIN:
        for one in pattern.finditer(text):
            if pattern is not _IPV4 or not _NOBODY.match(one[0]):
                yield Match(kind, one.start(), one.end(), GONE, why)
    for start, stop in positions_in(text):
        yield Match("gps", start, stop, GONE, "a position on earth")


def _paths(text: str) -> Iterator[Match]:
    for one in _DEVICE.finditer(text):
        yield Match("serial", one.start(), one.end(), GONE, "a device's path with its serial")
    whole = _WHOLE.fullmatch(text) or _WHOLE_WINDOWS.fullmatch(text)
    if whole:  # with spaces in it, perhaps
        yield _path(text, 0, len(text))
        return
    for pattern in (_POSIX, _WINDOWS):
        for one in pattern.finditer(text):
            end = one.end() - len(one[0]) + len(one[0].rstrip(".,"))
            if not _DEV.fullmatch(one[0]):
                yield _path(text, one.start(), end)


def _path(text: str, start: int, stop: int) -> Match:
    path = text[start:stop]
    name = re.split(r"[/\\]", path.rstrip("/\\"))[-1]
    is_home = _HOME_ALONE.fullmatch(path) is not None
    why = "a home folder" if _HOME.search(path) or path[0] == "~" else "an absolute path"
    return Match("path", start, stop, GONE if is_home or not name else name, why)
