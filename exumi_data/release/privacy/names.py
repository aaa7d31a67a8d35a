"""Names of people found in texts: in other letters, in another Unicode form, or in part."""

import re
import unicodedata
from collections.abc import Iterator, Mapping
from functools import lru_cache

from exumi_data.release.privacy.kinds import Kind

__all__ = ["named_in"]

_LEAST_PART = 4
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

    Letters are compared without case and accents. A part has at least four letters and stands
    alone.

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
    for name, kind in names.items():
        for wanted, spelt, is_part in _wanted(name, kind):
            for start, stop in _found(wanted, folded, places):
                if not _is_everyday(text[start:stop], spelt, wanted, is_part=is_part):
                    why = f"a part of the {kind}'s name" if is_part else f"the {kind} is named"
                    yield start, stop, kind, why


def _is_everyday(found: str, spelt: str, wanted: str, *, is_part: bool) -> bool:
    """Whether what was found is an everyday word, and no name."""
    if found == spelt or not found.islower() or " " in wanted:
        return False
    return is_part or wanted in _WORDS


def _found(wanted: str, folded: str, places: list[int] | None) -> Iterator[tuple[int, int]]:
    at = folded.find(wanted)
    while at >= 0:
        end = at + len(wanted)
        before, after = folded[at - 1 : at], folded[end : end + 1]
        if not (_is_letter(before) or _is_letter(after)):
            yield (at, end) if places is None else (places[at], places[end])
        at = folded.find(wanted, end)


def _is_letter(one: str) -> bool:
    return one.isalnum() or one == "_"


@lru_cache(maxsize=4096)
def _wanted(name: str, kind: Kind) -> tuple[tuple[str, str, bool], ...]:
    """Return what is looked for: folded, as it was spelt, and whether it is a part."""
    whole = _folded(name)[0]
    found = [(whole, name, False)] if whole.strip() else []
    words = name.split()
    if kind == "operator" and 2 <= len(words) <= 5 and not any(c.isdigit() for c in name):
        for part in _PART.findall(unicodedata.normalize("NFC", name)):
            plain = _folded(part)[0]
            if len(plain) >= _LEAST_PART and plain not in _NO_NAMES:
                found.append((plain, part, True))
    return tuple(found)


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
