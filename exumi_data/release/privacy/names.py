"""Names of people found in texts: in other letters, in another Unicode form, or in part."""

import itertools
import re
import unicodedata
from collections.abc import Iterator, Mapping
from functools import lru_cache

from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.structure import vocabulary

__all__ = ["named_in"]

_LEAST_PART = 4
_BLANKS = re.compile(r"[\s_]+")
_HEX = re.compile(r"[0-9a-f]+")
_HEX_BEFORE = re.compile(r"[0-9a-f]+\Z")
_MOST_CODE = 64
# Ids and digests: letters in them are nobody's name.
_CODE = re.compile(
    r"(?<![0-9a-z])(?:[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}|[0-9a-f]{32,})(?![0-9a-z])"
)
_PART = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*")
# Mark is a person, to mark is not: in small letters these are no names. Those of the second
# paragraph are no part of a person's name either.
_WORDS = frozenset([
    "art", "august", "baker", "banks", "bill", "brown", "carter", "chance", "chase", "chip",
    "christian", "cliff", "cook", "crystal", "dale", "dawn", "dean", "drew", "earl", "eve",
    "faith", "field", "flora", "forest", "frank", "gene", "grace", "grant", "gray", "green",
    "guy", "hand", "heather", "hill", "hope", "hunter", "iris", "ivy", "jack", "jade", "jasper",
    "jay", "jimmy", "josh", "joy", "june", "king", "knight", "lance", "lane", "lily", "long",
    "mark", "mason", "max", "may", "melody", "mercy", "mike", "miles", "miller", "norm",
    "olive", "page", "park", "pat", "patience", "peg", "penny", "pierce", "price", "ray",
    "reed", "rich", "rob", "robin", "rock", "rose", "ruby", "rusty", "sandy", "sharp", "skip",
    "small", "sterling", "stone", "strong", "sue", "summer", "swift", "trip", "victor", "viola",
    "violet", "wade", "ward", "west", "white", "will", "wolf", "wood", "young",
])  # fmt: skip
_NO_NAMES = frozenset([
    "account", "anonymous", "collector", "demonstrator", "expert", "first", "four", "from",
    "group", "hand", "human", "lab", "left", "member", "none", "novice", "number", "operator",
    "participant", "person", "pilot", "right", "robot", "second", "student", "subject", "team",
    "test", "tester", "third", "three", "unknown", "user", "with", "worker",
])  # fmt: skip


def named_in(text: str, names: Mapping[str, Kind]) -> Iterator[tuple[int, int, Kind, str]]:
    """Yield where a text has a name, or a part of an operator's.

    Letters are compared without case and accents. A name ends where a sign, a line below or a digit
    stands, and its blanks may be others or none, as in names of files. A part has at least four
    letters and stands alone.

    Parameters
    ----------
    text : str
    names : mapping of str to str
        Names, and the kind of each.

    Yields
    ------
    start, stop : int
    kind : str
    why : str
    """
    if not names or not text:
        return
    folded, places = _folded(text)
    codes: list[tuple[int, int]] | None = None
    for name, kind in names.items():
        for wanted, spelt, is_part, first in _wanted(name, kind):
            if first not in folded:  # nearly always, and much faster
                continue
            for at, end, is_joined in _found(wanted, folded):
                if codes is None:
                    codes = [one.span() for one in _CODE.finditer(folded)]
                if any(a <= at and end <= b and (a, b) != (at, end) for a, b in codes):
                    continue
                start, stop = (at, end) if places is None else (places[at], places[end])
                found = text[start:stop]
                if not _is_everyday(found, spelt, wanted, is_part=is_part, is_joined=is_joined):
                    why = f"a part of the {kind}'s name" if is_part else f"the {kind} is named"
                    yield start, stop, kind, why


def _is_everyday(found: str, spelt: str, wanted: str, *, is_part: bool, is_joined: bool) -> bool:
    """Whether what was found is an everyday word, and no name."""
    if len(_BLANKS.split(wanted)) > 1:
        return False
    if is_joined and found.islower() and (wanted in _NO_NAMES or wanted in vocabulary()):
        return True
    if found == spelt or not found.islower():
        return False
    return wanted in _WORDS or (is_part and not is_joined)


def _found(wanted: str, folded: str) -> Iterator[tuple[int, int, bool]]:
    """Yield where a name stands, and whether it is joined to other words as in a file's name."""
    for one in _pattern(wanted).finditer(folded):
        at, end = one.span()
        before, after = folded[at - 1 : at], folded[end : end + 1]
        is_apart = _is_end(before, folded[at], wanted) and _is_end(after, folded[end - 1], wanted)
        if is_apart and not _is_in_code(folded, at, end):
            is_file = after == "." and folded[end + 1 : end + 2].isalnum()
            yield at, end, is_file or _is_joint(before) or _is_joint(after)


def _is_end(beyond: str, last: str, wanted: str) -> bool:
    """Whether a name ends there: at a digit after letters, or a letter after digits.

    A name that is a number does not: it may have a unit.
    """
    if not beyond.isalnum():
        return True
    return beyond.isdigit() != last.isdigit() and any(one.isalpha() for one in wanted)


def _is_joint(one: str) -> bool:
    return one == "_" or one.isalnum()


def _is_in_code(folded: str, at: int, end: int) -> bool:
    """Whether what was found may be digits of a short code in hexadecimal, such as a commit's."""
    if not _HEX.fullmatch(folded, at, end):
        return False
    before, after = (
        _HEX_BEFORE.search(folded[max(0, at - _MOST_CODE) : at]),
        _HEX.match(folded, end),
    )
    around = [part[0] for part in (before, after) if part]
    is_number = any(one.isdigit() for one in folded[at:end])  # as the e3 of 1e3
    return len(around) == 2 or any(is_number or not part.isdigit() for part in around)


@lru_cache(maxsize=4096)
def _pattern(wanted: str) -> re.Pattern[str]:
    """Return what finds a name, whatever stands for its blanks."""
    words = [word for word in _BLANKS.split(wanted) if word]
    if not words:
        return re.compile(re.escape(wanted))
    found = re.escape(words[0])
    for before, after in itertools.pairwise(words):
        # Between digits something has to stand, and no point: 1 5 is neither 15 nor 1.5.
        blank = r"[\s_]+" if before[-1].isdigit() and after[0].isdigit() else r"[\s_.\\-]*"
        found += blank + re.escape(after)
    return re.compile(found)


@lru_cache(maxsize=4096)
def _wanted(name: str, kind: Kind) -> tuple[tuple[str, str, bool, str], ...]:
    """Return what is looked for: folded, as it was spelt, whether it is a part, its first word."""
    whole = _folded(name)[0]
    found = [(whole, name, False)] if whole.strip() else []
    words = name.split()
    if kind == "operator" and 2 <= len(words) <= 5 and not any(c.isdigit() for c in name):
        for part in _PART.findall(unicodedata.normalize("NFC", name)):
            plain = _folded(part)[0]
            if len(plain) >= _LEAST_PART and plain not in _NO_NAMES:
                found.append((plain, part, True))
    return tuple((*one, _BLANKS.split(one[0], maxsplit=1)[0]) for one in found)


def _folded(text: str) -> tuple[str, list[int] | None]:
    """Return a text without case and accents, and where each letter of that stands in the text.

    None: where it stands in what is returned. The list has one place more, the end.
    """
    if text.isascii():
        return text.lower(), None
    letters: list[str] = []
    places: list[int] = []
    for at, one in enumerate(text):
        for letter in unicodedata.normalize("NFKD", one.casefold()):
            if not unicodedata.combining(letter):
                letters.append(letter)
                places.append(at)
    return "".join(letters), [*places, len(text)]
