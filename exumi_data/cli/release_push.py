"""``exumi release push``."""

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

    with progress_of("Publishing (MiB)", quiet=quiet) as update:
        return push_release(
            release,
            repository,
            judge_with(workers),
            public=public,
            workers=workers,
            on_progress=lambda what, done, total: update(
                done // _STEP, total // _STEP, what.lower()
            ),
        )


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
    if pushed.others and not quiet:
        named = ", ".join(pushed.others[:_SHOWN])
        print(printable(f"  {len(pushed.others):,} other files are there, and stay: {named}"))
