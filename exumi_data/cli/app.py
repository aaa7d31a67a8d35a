"""The program ``exumi``: its verbs, and ``--version``."""

from typing import Annotated

import typer

from exumi_data.cli import (
    attach,
    calibrate_group,
    convert,
    dataset_group,
    demo,
    index_group,
    info,
    pack,
    prepare,
    record,
    recover,
    release_group,
    rig_group,
    stats,
    validate,
    view,
)
from exumi_data.cli.failures import (
    ReportingGroup,
    escape_what_cannot_be_printed,
    open_closed_streams,
    stop_on_signals,
)
from exumi_data.cli.options import group

__all__ = ["app", "main"]

app = group(
    "Record, convert, check and load tactile robot data: the exUMI Episode toolkit.",
    "exumi demo",
    "exumi convert clips/ my-dataset --from octopi --labels labels.csv",
    "exumi validate my-dataset",
    name="exumi",
    cls=ReportingGroup,
    no_args_is_help=True,
    add_completion=False,
)

app.command("demo", epilog=demo.EPILOG)(demo.run)
app.command("attach", epilog=attach.EPILOG)(attach.run)
app.add_typer(calibrate_group.app, name="calibrate")
app.command("convert", epilog=convert.EPILOG)(convert.run)
app.command("prepare", epilog=prepare.EPILOG)(prepare.run)
app.add_typer(index_group.app, name="index")
app.add_typer(dataset_group.app, name="dataset")
app.command("pack", epilog=pack.EPILOG)(pack.run)
app.add_typer(rig_group.app, name="rig")
app.command("record", epilog=record.EPILOG)(record.run)
app.command("recover", epilog=recover.EPILOG)(recover.run)
app.command("validate", epilog=validate.EPILOG)(validate.run)
app.add_typer(release_group.app, name="release")
app.command("stats", epilog=stats.EPILOG)(stats.run)
app.command("view", epilog=view.EPILOG)(view.run)
app.command("info", epilog=info.EPILOG)(info.run)


def _print_version(wanted: bool) -> None:
    if wanted:
        from exumi_data._version import __version__
        from exumi_data.model.episode import FORMAT_VERSION

        typer.echo(f"exumi-data {__version__} (format {FORMAT_VERSION})")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Print the versions of the library and of the format.",
        ),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the program; ends the process with one of the package's exit codes."""
    stop_on_signals()
    open_closed_streams()
    escape_what_cannot_be_printed()
    app(prog_name="exumi")
