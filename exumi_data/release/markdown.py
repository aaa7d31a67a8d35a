"""Markdown of words that somebody else wrote: nothing in them is taken for mark-up."""

import html
import re
from collections.abc import Iterable, Sequence

__all__ = ["amount", "bytes_text", "code_block", "duration", "listed", "plain", "table"]

# A line below between letters, as in object_id, is no mark-up.
_MARKUP = re.compile(r"([\\`*{}\[\]#|~$]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9]))")
# At its beginning, a line that is one of a list, a rule, or the mark of a heading above it.
_BEGINNING = re.compile(r"^([-+=](?=[-+= ]|$)|\d{1,9}(?=[.)](?: |$)))")
_MOST = 400


def plain(text: object, *, most: int | None = _MOST) -> str:
    """Return a text that reads as itself, on one line.

    Parameters
    ----------
    text : object
    most : int or None
        Letters; what is beyond is cut off.
    """
    line = " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())
    line = line if most is None or len(line) <= most else f"{line[: most - 1]}…"
    escaped = _MARKUP.sub(r"\\\1", html.escape(line, quote=False))
    return _BEGINNING.sub(lambda found: _escaped_beginning(found[1]), escaped)


def _escaped_beginning(text: str) -> str:
    return f"{text}\\" if text.isdecimal() else f"\\{text}"


def table(head: Sequence[str], rows: Iterable[Sequence[object]], *, most: int = 30) -> list[str]:
    """Return the lines of a table; what is beyond `most` rows is only counted.

    Parameters
    ----------
    head : sequence of str
        Names of columns; those of numbers end with a colon.
    rows : iterable of sequence
    most : int
    """
    every = [list(row) for row in rows]
    if not every:
        return []
    right = [name.endswith(":") for name in head]
    lines = [f"| {' | '.join(plain(name.removesuffix(':')) for name in head)} |"]
    lines.append(f"|{'|'.join('---:' if one else '---' for one in right)}|")
    lines += [f"| {' | '.join(plain(cell) for cell in row)} |" for row in every[:most]]
    if len(every) > most:
        lines += ["", f"… and {len(every) - most:,} more."]
    return [*lines, ""]


def listed(items: Iterable[object], *, most: int = 30) -> list[str]:
    """Return the lines of a list; what is beyond `most` is only counted."""
    every = [f"- {plain(item)}" for item in items]
    more = [f"- … and {len(every) - most:,} more"] if len(every) > most else []
    return [*every[:most], *more, ""] if every else []


def code_block(text: str, language: str) -> list[str]:
    """Return a block of code, whatever is in it."""
    fence = "```"
    while fence in text:
        fence += "`"
    return [f"{fence}{language}", text, fence, ""]


def amount(count: int, thing: str) -> str:
    """Return ``1 episode`` and ``264 episodes``."""
    return f"{count:,} {thing}" if count == 1 else f"{count:,} {thing}s"


def duration(seconds: float) -> str:
    """Return a time as a person says it."""
    if seconds >= 5400:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.1f} min" if seconds >= 90 else f"{seconds:.1f} s"


def bytes_text(count: float) -> str:
    """Return a size in units of a thousand."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"
