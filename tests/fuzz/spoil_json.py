"""Spoiling JSON documents that stay JSON, most of the time."""

import json
from collections.abc import Callable
from random import Random
from typing import Any

__all__ = ["spoil_document"]

Place = tuple[Any, Any]  # a container, and a key or index in it

NUMBERS: tuple[object, ...] = (
    0, 1, -1, 2, 255, 65536, -(1 << 31), 1 << 31, (1 << 63) - 1, 1 << 63, -(1 << 63), 1 << 64,
    10**40, 10**400, 0.5, -0.0, 1e-320, 1e308, -1e308, 3.0, 1e15,
)  # fmt: skip
TEXTS: tuple[object, ...] = (
    "", " ", "x", "..", "../../etc/passwd", "/etc/passwd", "a/b", "a\\b", "C:x", "\0", "\x7f",
    "\u202e", "é" * 300, "x" * 100_000, "1.0", "1.1", "2.0", "0.0", "01.0", "1.10", "1" * 30,
    "1/0", "0/1", "1/999999999999999999", "999999999999999999/1", "2026-02-30T00:00:00Z",
    "2026-05-04T10:20:30.123456789Z", "ns", "s", "count", "acme:x", "pose", "tactile", "rgb",
    "width", "wrench", "taxels", "time", "data", "flags", "raw", "offset", "encoded", "array",
    "video", "nominal_rate", "time_host", "time_device", "uint8", "float64", "int64", "NaN",
    "018f0000-0000-7000-8000-0000000000a1", "streams/width/time", "calibration/map", "\ud800",
    "{}", "{path}", "[/]", "0" * 64, "\U0001f600",
)  # fmt: skip
SHAPES: tuple[object, ...] = (
    None, True, False, [], {}, [[]], [0], [1], [-1], [0, 0], [1, 2, 3], {"": {}}, [None], ["x"],
    {"a": 1}, [1 << 62], [1 << 31, 1 << 31], [1, 1, 1, 1], [5], [float(1)], list(range(300)),
)  # fmt: skip


def _places(value: Any) -> list[Place]:
    found: list[Place] = []
    pending = [value]
    while pending:
        here = pending.pop()
        keys = here.items() if isinstance(here, dict) else enumerate(here)
        for key, item in keys:
            found.append((here, key))
            if isinstance(item, dict | list):
                pending.append(item)
    return found


def _remove(place: Place, document: Any, random: Random) -> None:
    del place[0][place[1]]


def _number(place: Place, document: Any, random: Random) -> None:
    place[0][place[1]] = random.choice(NUMBERS)


def _text(place: Place, document: Any, random: Random) -> None:
    place[0][place[1]] = random.choice(TEXTS)


def _shape(place: Place, document: Any, random: Random) -> None:
    place[0][place[1]] = json.loads(json.dumps(random.choice(SHAPES)))


def _nudge(place: Place, document: Any, random: Random) -> None:
    value = place[0][place[1]]
    if isinstance(value, bool) or not isinstance(value, int | float):
        _number(place, document, random)
    else:
        factor = random.choice((-1, 2, 10, 1000, 0.5, 1 << 32))
        place[0][place[1]] = value * factor if random.random() < 0.5 else value + factor


def _swap(place: Place, document: Any, random: Random) -> None:
    other = random.choice(_places(document))
    place[0][place[1]] = json.loads(json.dumps(other[0][other[1]]))


def _rename(place: Place, document: Any, random: Random) -> None:
    container, key = place
    if isinstance(container, dict):
        new = random.choice((str(random.choice(TEXTS)), key + "x", key.upper(), "acme:" + key))
        container[new] = container.pop(key)
    else:
        container.insert(0, json.loads(json.dumps(container[key])))


def _repeat(place: Place, document: Any, random: Random) -> None:
    value = place[0][place[1]]
    if isinstance(value, list):
        place[0][place[1]] = value * random.choice((2, 3, 500))
    elif isinstance(place[0], dict):
        place[0][place[1] + "2"] = json.loads(json.dumps(value))
    else:
        place[0].append(json.loads(json.dumps(value)))


def _nest(place: Place, document: Any, random: Random) -> None:
    depth = random.choice((1, 2, 30, 90, 150, 300, 700, 900))
    value = place[0][place[1]]
    for _ in range(depth):
        value = [value] if random.random() < 0.5 else {"x": value}
    place[0][place[1]] = value


_WAYS: tuple[Callable[[Place, Any, Random], None], ...] = (
    _remove, _remove, _number, _number, _text, _text, _text, _shape, _shape, _nudge, _nudge,
    _swap, _swap, _rename, _repeat, _nest,
)  # fmt: skip


def _raw(data: bytes, random: Random) -> bytes:
    """Make JSON that Python would not write."""
    text = data.decode("utf-8", "replace")
    at = random.randrange(len(text) + 1)
    odd = random.choice(
        ('"a":1,"a":2,', "NaN", "1e999", "-", "\\u0000", "\ufeff", "[" * 5000, '{"a":' * 5000,
         "9" * 5000, "9" * 4000, "/**/", ",,", '"\\ud800"', "\0", "}", "]" )
    )  # fmt: skip
    if odd.startswith('"a"'):
        brace = text.find("{", at)
        at = brace + 1 if brace >= 0 else at
        key = text[at:].partition('"')[2].partition('"')[0]
        odd = f'"{key}":null,'
    return (text[:at] + odd + text[at:]).encode("utf-8", "replace")


def spoil_document(data: bytes, random: Random) -> tuple[bytes, str]:
    """Return another document, and what was done."""
    if random.random() < 0.12:
        return _raw(data, random), "raw JSON"
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return _raw(data, random), "raw JSON"
    done = []
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        places = _places(document) if isinstance(document, dict | list) else []
        if not places:
            break
        # Most of the places are deep inside; those near the root matter as much.
        place = random.choice(places if random.random() < 0.7 else places[:40])
        way = random.choice(_WAYS)
        way(place, document, random)
        done.append(f"{way.__name__.strip('_')} {str(place[1])[:40]}")
    try:
        return json.dumps(document).encode(), ", ".join(done)
    except (RecursionError, ValueError):
        return _raw(data, random), "raw JSON"
