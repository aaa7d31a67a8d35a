"""``exumi release push``."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import (
    Format,
    FormatOption,
    QuietOption,
    WorkersOption,
    epilog,
    given_path,
)

if TYPE_CHECKING:
    from exumi_data.release.pushing import Pushed

__all__ = ["EPILOG", "push", "run", "tell_pushed"]

EPILOG = epilog(
    "exumi release push my-release our-lab/my-dataset",
    "exumi release push my-release our-lab/my-dataset --public",
)
_STEP = 1 << 20
_SHOWN = 5


def run(
    release: Annotated[
        Path, typer.Argument(parser=given_path, metavar="DST", help="The folder of a release.")
    ],
    repository: Annotated[
        str, typer.Argument(metavar="REPO", help="On the hub: owner/name. Made if it is not there.")
    ],
    public: Annotated[
        bool, typer.Option("--public", help="A new repository is seen by everybody.")
    ] = False,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Publish a release on the Hugging Face hub, after verifying and validating it.

    It appears there all at once, with a tag of its version. Started again after it was stopped, it
    goes on. A new repository is private, unless --public is said. HF_ENDPOINT names another server,
    HF_TOKEN the account (or hf auth login).
    """
    from dataclasses import asdict

    from exumi_data.cli.output import print_json

    pushed = push(release, repository, public=public, workers=workers, quiet=quiet)
    if output is Format.JSON:
        print_json(asdict(pushed))
    else:
        tell_pushed(pushed, quiet=quiet)


def push(
    release: Path, repository: str, *, public: bool, workers: int | None, quiet: bool
) -> "Pushed":
    """Publish a release, with a bar.

    Parameters
    ----------
    release : pathlib.Path
    repository : str
    public : bool
    workers : int or None
    quiet : bool
    """
    from exumi_data.cli.output import progress_of
    from exumi_data.cli.release_judge import judge_with
    from exumi_data.release.pushing import push_release

    with progress_of("Publishing (MiB)", quiet=quiet) as update, _restored_signal():

        def tell(what: str, done: int, total: int) -> None:
            if what == "Uploading":
                signal.signal(signal.SIGINT, _leave)
            update(done // _STEP, total // _STEP, what.lower())

        return push_release(
            release,
            repository,
            judge_with(workers),
            public=public,
            workers=workers,
            on_progress=tell,
        )


@contextmanager
def _restored_signal() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _leave(_number: int, _frame: object) -> None:
    """End the program at once: unwinding would wait until what is on its way has been sent."""
    from exumi_data.cli.failures import INTERRUPTED
    from exumi_data.cli.output import error_console

    error_console().show_cursor()
    sys.stderr.write("\nstopped. What was uploaded is kept: run the same command again.\n")
    sys.stderr.flush()
    os._exit(INTERRUPTED)


def tell_pushed(pushed: "Pushed", *, quiet: bool) -> None:
    """Tell people what was published.

    Parameters
    ----------
    pushed : Pushed
    quiet : bool
    """
    from exumi_data.cli.output import printable

    what = "was published already" if pushed.already else "is published"
    print(printable(f"{pushed.url}: {pushed.tag} {what}, {pushed.files:,} files"))
    if pushed.removed:
        print(f"  {len(pushed.removed):,} files of the release before it were removed")
    if pushed.replaced:
        named = ", ".join(pushed.replaced[:_SHOWN])
        count = f"{len(pushed.replaced):,} files that belonged to no release were replaced"
        print(printable(f"  {count}, and are in the repository's history: {named}"))
    if pushed.others and not quiet:
        named = ", ".join(pushed.others[:_SHOWN])
        print(printable(f"  {len(pushed.others):,} other files are there, and stay: {named}"))
