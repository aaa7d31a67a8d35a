"""``exumi release verify``."""

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
    "exumi release verify my-release",
    "exumi release verify my-release --quick",
    "exumi release verify my-release --format json > verified.json",
)
_SHOWN = 50
_STEP = 1 << 20


def run(
    release: Annotated[
        Path, typer.Argument(parser=given_path, metavar="DST", help="A release, or its preview.")
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Names, sizes and structure alone: no data are read.")
    ] = False,
    fingerprint: Annotated[
        str | None,
        typer.Option(
            metavar="SHA256",
            help="Of the manifest, as published elsewhere: then the manifest, too, is verified.",
        ),
    ] = None,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Compare a copy of a release with its manifest: every byte, and that its parts agree.

    Exit code 0: all is as it was released. 1: something is not. 2: could not run. Started again
    after it was stopped, it goes on.
    """
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import print_json, printable, progress_of, size_text
    from exumi_data.release.verifying import verify_release

    with progress_of("Verifying (MiB)", quiet=quiet) as update:
        found = verify_release(
            release,
            quick=quick,
            fingerprint=fingerprint,
            workers=workers,
            on_progress=lambda done, total: update(done // _STEP, total // _STEP, ""),
        )
    if output is Format.JSON:
        print_json(found.to_json())
    else:
        what = "sizes and structure are" if quick else "everything is"
        said = f"{what} as released" if found.good else f"{len(found.findings):,} problem(s)"
        name = " ".join(one for one in (found.name, found.version) if one)
        print(
            printable(
                f"{release}: {name or 'a release'}, {found.files:,} files, "
                f"{size_text(found.bytes)}, {found.episodes:,} episodes: {said}"
            )
        )
        for one in found.findings[:_SHOWN]:
            print(printable(f"  {one.kind}: {one.path} {one.message}"))
            if one.expected is not None or one.found is not None:
                print(printable(f"      expected {one.expected}, found {one.found}"))
        if len(found.findings) > _SHOWN:
            print(f"  and {len(found.findings) - _SHOWN:,} more: see --format json")
        if found.resumed and not quiet:
            print(f"  {found.resumed:,} files had been read by a run that was stopped")
        print(f"  fingerprint (sha-256 of the manifest): {found.fingerprint}")
    if not found.good:
        raise typer.Exit(FOUND_WRONG)
