"""``exumi release diff``."""

from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.options import (
    Format,
    FormatOption,
    QuietOption,
    WorkersOption,
    epilog,
    given_path,
)

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi release diff my-release-1.0.0 my-release-1.1.0",
    "exumi release diff my-release my-dataset --format json",
)


def run(
    before: Annotated[
        Path, typer.Argument(parser=given_path, metavar="A", help="A release, or a dataset.")
    ],
    after: Annotated[
        Path, typer.Argument(parser=given_path, metavar="B", help="A later one, or a dataset.")
    ],
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Tell what changed from one release to another, and which step of the version it calls for.

    Episodes are added, removed, changed (other samples), relabelled (the same samples, of which
    something else is said), or written anew (the same in other bytes).
    """
    from exumi_data.cli.output import print_json, printable, progress_of
    from exumi_data.release.changelog import change_lines
    from exumi_data.release.changes import compare

    with progress_of("Comparing", quiet=quiet) as update:
        changes = compare(
            before,
            after,
            workers=workers,
            on_progress=lambda done, total: update(done, total, ""),
        )
    if output is Format.JSON:
        print_json({"before": str(before), "after": str(after), **changes.to_json()})
        return
    for line in change_lines(changes):
        print(printable(line))
    if changes.unchanged:
        print(f"{changes.unchanged:,} episodes are the same")
    print(f"This calls for a {changes.step} version." if changes.step else "Nothing differs.")
