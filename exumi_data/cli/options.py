"""Options that several verbs share, so that they are called the same everywhere."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

__all__ = [
    "DataArgument",
    "Format",
    "FormatOption",
    "QuietOption",
    "WorkersOption",
    "epilog",
    "given_data",
    "given_path",
    "group",
]


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
    typer.Option(
        "--workers",
        "-j",
        min=1,
        help="Processes to work with. Default: all cores, or what PYTHON_CPU_COUNT says.",
    ),
]


def given_path(text: str | Path) -> Path:
    """Return the path that a user named; an empty one and a URL are refused.

    Python takes an empty one as the current folder, while it comes from a variable that was not
    set; and of a URL it drops a slash.

    Parameters
    ----------
    text : str or pathlib.Path
        What was typed, or the default of an option, which is a path already.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    UsageError
        It is empty.
    UnsupportedError
        It is a URL.
    """
    from exumi_data.errors import UnsupportedError, UsageError

    if isinstance(text, Path):
        return text
    if "://" in text:
        raise UnsupportedError(
            "this works on local files, not on a URL",
            where=text,
            fix="Download it and give the local path.",
        )
    if not text:
        raise UsageError("an empty path was given", fix="For the current folder, say: .")
    return Path(text)


def given_data(text: str) -> str:
    """Return the path or the URL that a user named; an empty one is refused.

    Parameters
    ----------
    text : str
        What was typed.

    Raises
    ------
    UsageError
        It is empty.
    """
    return text if "://" in text else str(given_path(text))


DataArgument = Annotated[
    str,
    typer.Argument(
        parser=given_data,
        metavar="PATH",
        help="A dataset, or one episode (.zarr or .zarr.zip); or a URL: s3://, gs://, az://, "
        "https://.",
    ),
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


def group(text: str, *examples: str, **options: Any) -> typer.Typer:
    """Return a group of verbs, with what is the same in all groups.

    Parameters
    ----------
    text : str
        What it is for.
    *examples : str
        As of `epilog`.
    **options
        More of Typer's.

    Returns
    -------
    typer.Typer
    """
    return typer.Typer(
        help=text,
        epilog=epilog(*examples),
        # Plain text: rich's help looks richer, and takes three times as long to appear.
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        **options,
    )
