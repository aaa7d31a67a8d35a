"""``exumi rig``: the file that says what a rig is made of, begun and checked."""

import typer

from exumi_data.cli import rig_check, rig_init
from exumi_data.cli.options import epilog

__all__ = ["app"]

app = typer.Typer(
    help="Begin a rig file, and check a rig before recording with it.",
    epilog=epilog("exumi rig init exumi rig.toml", "exumi rig check rig.toml"),
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("init", epilog=rig_init.EPILOG)(rig_init.run)
app.command("check", epilog=rig_check.EPILOG)(rig_check.run)
