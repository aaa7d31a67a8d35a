"""What the verbs print with: results on stdout, everything else on stderr.

Colours and progress bars appear on a terminal only; ``NO_COLOR`` switches colours off there too.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from exumi_data.wording import size_text, time_text

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

__all__ = [
    "Update",
    "error_console",
    "plain",
    "plain_table",
    "print_json",
    "print_table",
    "printable",
    "progress_of",
    "result_console",
    "size_text",
    "time_text",
]

Update = Callable[[int, int | None, str], None]

_WIDTH_OF_A_FILE = 140


def _console(*, stderr: bool) -> "Console":
    from rich.console import Console

    class PrintableConsole(Console):
        def print(self, *objects: Any, **options: Any) -> None:
            """Print; in text that comes from files, codes that terminals obey are escaped."""
            safe = (printable(one, lines=True) if isinstance(one, str) else one for one in objects)
            super().print(*safe, **options)

    stream = sys.stderr if stderr else sys.stdout
    width = None
    if not stream.isatty() and "COLUMNS" not in os.environ:
        width = _WIDTH_OF_A_FILE
    return PrintableConsole(
        stderr=stderr, width=width, highlight=False, soft_wrap=stderr, emoji=False
    )


def result_console() -> "Console":
    """Return the console of results, stdout."""
    return _console(stderr=False)


def error_console() -> "Console":
    """Return the console of everything that is no result, stderr."""
    return _console(stderr=True)


def plain(value: object, *, lines: bool = False) -> str:
    """Return text that rich prints as it is: names and paths of users may look like markup.

    Parameters
    ----------
    value : object
        Its `str` is taken; what is not printable in it is escaped.
    lines : bool
        Keep the ends of lines.
    """
    from rich.markup import escape

    return escape(printable(str(value), lines=lines))


def printable(text: str, *, lines: bool = False) -> str:
    """Escape what is not printable: names in files may hold codes that terminals obey.

    Parameters
    ----------
    text : str
    lines : bool
        Keep the ends of lines.
    """
    return "".join(c if c.isprintable() or (lines and c == "\n") else ascii(c)[1:-1] for c in text)


def print_json(document: Any) -> None:
    """Print a JSON document on stdout, always the same way: two spaces, keys in their order.

    Parameters
    ----------
    document : Any
        What `json` can write; NaN and infinity are errors.
    """
    is_utf8 = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
    print(json.dumps(document, indent=2, ensure_ascii=not is_utf8, allow_nan=False))


def plain_table(*columns: tuple[str, str], header: bool = True) -> "Table":
    """Return an empty table without lines, which reads well on a terminal and in a file.

    Parameters
    ----------
    *columns : (str, str)
        Title, and ``left`` or ``right``.
    header : bool
        Whether the titles are shown.
    """
    from rich.table import Table

    table = Table(
        box=None, show_header=header, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0)
    )
    for title, side in columns:
        right = side == "right"
        table.add_column(title, justify="right" if right else "left", no_wrap=right)
    return table


def print_table(table: "Table", console: "Console") -> None:
    """Print a table without the blanks that rich fills its lines with.

    Parameters
    ----------
    table : rich.table.Table
    console : rich.console.Console
    """
    from rich.segment import Segment, Segments

    lines = console.render_lines(table, pad=False)
    kept: list[Segment] = []
    for line in lines:
        while line and not line[-1].text.strip():
            line.pop()
        if line:
            line[-1] = Segment(line[-1].text.rstrip(), line[-1].style)
        kept += [*line, Segment.line()]
    console.print(Segments(kept), end="")


@contextmanager
def progress_of(what: str, *, quiet: bool) -> Iterator[Update]:
    """Show a progress bar on stderr while the block runs; on a terminal only.

    Parameters
    ----------
    what : str
        What is done, such as ``Converting``.
    quiet : bool
        Show nothing.

    Yields
    ------
    callable
        Call it with the number of steps done, the number of all steps (None if that is not known)
        and a word on how it goes.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda _done, _total, _note: None
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("[dim]{task.fields[note]}"),
    )
    with Progress(*columns, console=error_console(), transient=True) as bar:
        task = bar.add_task(what, total=None, note="")
        yield lambda done, total, note: bar.update(task, completed=done, total=total, note=note)
