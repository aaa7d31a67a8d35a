"""``exumi pack``."""

from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.options import QuietOption, epilog, given_path

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi pack my-dataset/episodes/3f/0190a1b2-4c5d-7e8f-9a0b-1c2d3e4f503f.zarr",
    "exumi pack grasp.zarr --to release/grasp.zarr.zip",
)


def run(
    episode: Annotated[
        Path,
        typer.Argument(
            parser=given_path, metavar="EPISODE", help="An episode's folder, <name>.zarr. It stays."
        ),
    ],
    to: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="PATH",
            help="The zip to write. Default: <name>.zarr.zip beside it.",
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing file.")
    ] = False,
    quiet: QuietOption = False,
) -> None:
    """Copy an episode into one stored zip, which reads as fast as the folder.

    Prints the zip's path. The same episode always gives the same bytes.
    """
    from exumi_data.cli.output import error_console, size_text
    from exumi_data.episode import open_episode
    from exumi_data.errors import UsageError
    from exumi_data.store.pack import pack

    with open_episode(episode) as opened:
        if not episode.is_dir():
            raise UsageError("is packed already", where=episode)
        opened.check_complete()
    target = pack(episode, to, overwrite=overwrite)
    print(target)
    if not quiet:
        size = size_text(target.stat().st_size)
        error_console().print(f"{opened.id}: {size}", style="dim", markup=False)
