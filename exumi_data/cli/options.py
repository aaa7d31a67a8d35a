"""Options that several verbs share, so that they are called the same everywhere."""

from enum import StrEnum
from typing import Annotated

import typer

__all__ = ["Format", "FormatOption", "QuietOption", "WorkersOption", "epilog"]


class Format(StrEnum):
    """How a result is printed."""

    TEXT = "text"
    JSON = "json"


FormatOption = Annotated[
    Format, typer.Option("--format", "-f", help="Print for people, or as JSON for programs.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print results and errors only.")]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", "-j", min=1, help="Processes to work with. Default: all cores."),
]


def epilog(*examples: str) -> str:
    """Return the end of a verb's help: commands to try.

    Parameters
    ----------
    *examples : str
        Commands that would run as they stand, given the data they name.

    Returns
    -------
    str
        Typer prints it as it stands.
    """
    # A line with \b alone keeps the lines of a paragraph apart.
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in examples)])
