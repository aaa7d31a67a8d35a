"""Invalid cases: packed episodes."""

import warnings
from collections.abc import Iterator

from corpus import bases
from corpus.case import Case, Finding, as_zip, packed, packing_key

__all__ = ["packing_cases"]

WHOLE = "."


def _members() -> list[tuple[str, bytes]]:
    return sorted(bases.poses().files().items(), key=lambda item: packing_key(item[0]))


def _reaching(archive: bytes, name: str) -> bytes:
    """Let both headers of a member say that it is 20 bytes longer."""
    out = bytearray(archive)
    local, listed = (
        place - header for place, header in zip(_places(archive, name), (30, 46), strict=True)
    )
    for start in (local + 18, listed + 20):
        for at in (start, start + 4):
            out[at : at + 4] = (int.from_bytes(out[at : at + 4], "little") + 20).to_bytes(
                4, "little"
            )
    return bytes(out)


def _places(archive: bytes, name: str) -> tuple[int, int]:
    first = archive.index(name.encode())
    return first, archive.index(name.encode(), first + 1)


def packing_cases() -> Iterator[Case]:
    """Yield the cases of packing and of unsafe paths."""
    whole = as_zip(bases.poses().files())
    count = len(_members())
    cut = whole[: len(whole) // 2]
    yield packed("PACK-001__cut_short", "Half a zip.", cut, Finding("PACK-001", WHOLE))
    data = as_zip(bases.poses().files(), compressed="streams/pose/data/c/0/0")
    at = Finding("PACK-002", WHOLE, index=count - 2)
    yield packed("PACK-002__compressed", "A compressed member.", data, at)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a name stands twice is the point
        data = as_zip([*_members(), ("streams/pose/data/c/0/0", b"another")])
    at = Finding("PACK-003", WHOLE, index=count)
    yield packed("PACK-003__twice", "A name that stands twice.", data, at)
    data = as_zip([*_members(), ("streams/", b"")])
    at = Finding("PACK-004", WHOLE, index=count)
    yield packed("PACK-004__folder", "An entry for a folder.", data, at)
    first, second, *rest = _members()
    data = as_zip([second, first, *rest])
    at = Finding("PACK-005", WHOLE, index=0)
    yield packed("PACK-005__root_second", "The root's document comes second.", data, at)
    data = as_zip(bases.poses().files(), date=(2026, 5, 4, 10, 20, 30))
    at = Finding("PACK-006", WHOLE, index=0)
    yield packed("PACK-006__dated", "Members with a date.", data, at)
    place = whole.index(b"streams/pose/data/c/0/0")
    data = whole[:place] + b"streams/pose/DATA/c/0/0" + whole[place + 23 :]
    at = Finding("PACK-007", WHOLE, index=count - 2)
    yield packed("PACK-007__two_names", "Two names for one member.", data, at)
    at = Finding("PACK-007", WHOLE, index=count - 1)
    about = "A member that reaches into the next one."
    yield packed("PACK-007__overlapping", about, _reaching(whole, "streams/pose/data/c/0/0"), at)
    at = Finding("PACK-008", WHOLE)
    about = "A program before the zip."
    yield packed("PACK-008__prefix", about, b"#!/bin/sh\n" + whole, at)
    place = whole.index(b"press the gel")
    data = whole[:place] + b"crush the gel" + whole[place + 13 :]
    at = Finding("PACK-009", WHOLE, index=0)
    yield packed("PACK-009__crushed", "Metadata changed within the zip.", data, at)
    data = as_zip([*_members(), ("../../evil.txt", b"gotcha")])
    at = Finding("SAFE-001", WHOLE, index=count)
    yield packed("SAFE-001__parent_folder", "A name that leads out.", data, at)
    data = as_zip([*_members(), ("streams/link", b"/etc/passwd")], links=("streams/link",))
    at = Finding("SAFE-002", WHOLE, index=count)
    yield packed("SAFE-002__link", "A link.", data, at)
