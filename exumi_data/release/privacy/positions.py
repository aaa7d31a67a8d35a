"""Positions on earth in texts, in the forms in which people and cameras write them."""

import re
from collections.abc import Iterator

__all__ = ["positions_in"]

_ISO6709 = re.compile(
    r"(?<![\w.])[+-]\d{2}(?:\d{2}){0,2}(?:\.\d+)?"  # degrees, with minutes and seconds
    r"[+-]\d{3}(?:\d{2}){0,2}(?:\.\d+)?(?:[+-]\d+(?:\.\d+)?)?/"
)
_LATITUDE = re.compile(
    r"(?i)\b(?:lat(?:itude)?|lon(?:gitude)?|lng)\b\s*[:=]?\s*[+-]?\d{1,3}\.\d{2,}"
)
# 48.13743, 11.57549: as exact as a few metres. What is longer than a pair is a vector, and what has
# a unit is a length.
_PAIR = re.compile(
    r"(?<![\w.,;+-])(?<![\w.][,;]\s)(?P<latitude>[+-]?\d{1,2}\.\d{4,})\s*[,;\s]\s*"
    r"(?P<longitude>[+-]?\d{1,3}\.\d{4,})(?!\w|\.\d)(?!\s*[,;]\s*[+-]?\.?\d)"
    r"(?!\s*(?:[munµ]?m|px|pixels?|m?N|m?s|rad|k?Hz)\b)"
)
# 48.1374 N 11.5755 E; N48 08.246 E011 34.529; 48°08'14.7"N, 11°34'31.8"E.
_ANGLE = (
    r"\d{1,3}(?:\.\d+)?(?:\s?°)?"
    r"(?:\s?\d{1,2}(?:\.\d+)?\s?['′’]?)?"
    r"""(?:\s?\d{1,2}(?:\.\d+)?\s?(?:["″”]|'')?)?"""
)
_BEFORE = re.compile(
    rf"(?i)(?<!\w)[NS]\s?(?P<latitude>{_ANGLE})\s*[,;/]?\s*[EW]\s?(?P<longitude>{_ANGLE})(?!\w)"
)
_AFTER = re.compile(
    rf"(?i)(?<![\w.])(?P<latitude>{_ANGLE})\s?[NS]\s*[,;/]?\s*(?P<longitude>{_ANGLE})\s?[EW](?!\w)"
)
_EXACT = re.compile(r"\.\d{3,}|[°'′’\"″”]")


def positions_in(text: str) -> Iterator[tuple[int, int]]:
    """Yield where positions begin and end.

    Parameters
    ----------
    text : str
    """
    for pattern in (_ISO6709, _LATITUDE):
        yield from (one.span() for one in pattern.finditer(text))
    for one in _PAIR.finditer(text):
        latitude, longitude = float(one["latitude"]), float(one["longitude"])
        # Within a degree of 0, 0 there is the sea: these are ratios.
        if abs(latitude) <= 90 and abs(longitude) <= 180 and max(abs(latitude), abs(longitude)) > 1:
            yield one.span()
    for pattern in (_BEFORE, _AFTER):
        for one in pattern.finditer(text):
            if _EXACT.search(one["latitude"]) and _EXACT.search(one["longitude"]):
                yield one.span()
