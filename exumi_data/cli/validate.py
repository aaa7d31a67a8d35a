"""``exumi validate``."""

from enum import StrEnum
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.engines import EngineName, EngineOption, RayAddressOption
from exumi_data.cli.options import DataArgument, QuietOption, WorkersOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_data.engine import Engine
    from exumi_validators import Config, Report
    from exumi_validators.fixing import CatalogFix
    from exumi_validators.text import Style

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi validate my-dataset",
    "exumi validate grasp.zarr.zip --level hierarchy",
    "exumi validate https://host/grasp.zarr.zip",
    "exumi validate my-dataset --format json > report.json",
    "exumi validate my-dataset --format junit > report.xml",
    "exumi validate my-dataset --config lab.toml --verbose",
    "exumi validate my-dataset --fix",
)
_STYLES: "dict[Style, str]" = {
    "plain": "",
    "error": "bold red",
    "warning": "yellow",
    "info": "cyan",
    "good": "bold green",
    "place": "bold",
    "dim": "dim",
}


class _Level(StrEnum):
    DOCUMENT = "document"
    HIERARCHY = "hierarchy"
    ARRAYS = "arrays"
    DATA = "data"


class _Format(StrEnum):
    TEXT = "text"
    JSON = "json"
    JUNIT = "junit"
    SARIF = "sarif"


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    path: DataArgument,
    level: Annotated[
        _Level,
        typer.Option(
            help="How far to look, each including those before: the documents, what is there, "
            "the arrays against each other, all data."
        ),
    ] = _Level.DATA,
    output: Annotated[
        _Format,
        typer.Option(
            "--format", "-f", help="Print for people, as JSON, or as what CI servers show."
        ),
    ] = _Format.TEXT,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="List every finding, however many there are.")
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FILE",
            help="TOML: rules to judge in another way ([validate.rules]), findings not to count "
            "([[validate.suppress]]). Default: the nearest exumi.toml, or pyproject.toml (there "
            "below [tool.exumi]), in this folder or above it.",
        ),
    ] = None,
    no_config: Annotated[
        bool, typer.Option("--no-config", help="Judge by the standard alone.")
    ] = False,
    fix: Annotated[
        bool,
        typer.Option(
            "--fix", help="Say what can be mended without guessing: the catalog of a dataset."
        ),
    ] = False,
    apply: Annotated[
        bool, typer.Option("--apply", help="With --fix: do it, then validate again.")
    ] = False,
    accept_changed: Annotated[
        bool,
        typer.Option(
            "--accept-changed",
            help="With --fix: take episodes as they are whose bytes are not those that the "
            "catalog knows.",
        ),
    ] = False,
    workers: WorkersOption = None,
    engine: EngineOption = EngineName.LOCAL,
    ray_address: RayAddressOption = None,
    quiet: QuietOption = False,
) -> None:
    """Check a dataset or an episode against the standard, and list every problem.

    Exit code 0: valid. 1: invalid, or not fully checked (the report says what was not, and why). 2:
    could not run, such as for a path that is not there.
    """
    from exumi_data.cli.engines import chosen_engine
    from exumi_data.engine import warm_up
    from exumi_data.errors import UsageError

    if engine is EngineName.LOCAL and _is_large(path):
        # It goes to workers: they load what they need while we do.
        warm_up("exumi_validators.validation", workers=workers)
    from exumi_validators.fixing import apply_fix, plan_fix

    if fix:
        given_path(path)  # a catalog at a URL is not written
    if (apply or accept_changed) and not fix:
        raise UsageError("--apply and --accept-changed belong to --fix", fix="Add --fix.")
    chosen = _config(path, config, no_config=no_config)
    made: CatalogFix | None = None
    with chosen_engine(engine, ray_address, workers=workers, reads=[path], quiet=quiet) as where:
        if fix:
            from exumi_data.cli.output import progress_of

            with progress_of("Reading", quiet=quiet) as update:
                made = (apply_fix if apply else plan_fix)(
                    path,
                    accept_changed=accept_changed,
                    workers=workers,
                    engine=where,
                    on_progress=lambda done, total: update(done, total, ""),
                )
        report = _validated(path, level, chosen, workers=workers, engine=where, quiet=quiet)
    _print_report(report, output, verbose=verbose)
    if made is not None:
        typer.echo(made.to_text(applied=apply), nl=False, err=output is not _Format.TEXT)
    raise typer.Exit(report.exit_code)


def _is_large(path: str) -> bool:
    """Whether a dataset has so many episodes that processes are started for them."""
    return len(list(islice(Path(path).glob("episodes/*/*.zarr*"), 8))) == 8


def _config(path: str, file: Path | None, *, no_config: bool) -> "Config | None":
    from exumi_data.errors import UsageError
    from exumi_validators import find_config, read_config

    if no_config:
        if file is not None:
            raise UsageError("--config and --no-config exclude each other")
        return None
    found = file or find_config(Path.cwd(), data=path)
    return None if found is None else read_config(found)


def _validated(
    path: str,
    level: _Level,
    config: "Config | None",
    *,
    workers: int | None,
    engine: "Engine | None",
    quiet: bool,
) -> "Report":
    from exumi_data.cli.output import progress_of
    from exumi_data.standard import LEVELS
    from exumi_validators import validate

    with progress_of("Validating", quiet=quiet) as update:
        report: Report = validate(
            path,
            levels=LEVELS[: LEVELS.index(level.value) + 1],
            config=config,
            workers=workers,
            engine=engine,
            on_progress=lambda done, total: update(done, total, ""),
        )
    return report


def _print_report(report: "Report", output: _Format, *, verbose: bool) -> None:
    from exumi_data.cli.output import result_console

    if output is not _Format.TEXT:
        renderers = {
            _Format.JSON: report.to_json,
            _Format.JUNIT: report.to_junit,
            _Format.SARIF: report.to_sarif,
        }
        print(renderers[output](), end="")
        return
    console = result_console()
    if console.color_system is None:
        print(report.to_text(verbose=verbose), end="")
        return
    from rich.text import Text

    from exumi_validators.text import text_lines

    for line in text_lines(report, verbose=verbose):
        pieces = ((text, _STYLES[style]) for text, style in line)
        console.print(Text.assemble(*pieces), soft_wrap=True)
