"""``exumi rig``: the file that says what a rig is made of, begun and checked."""

from exumi_data.cli import rig_check, rig_init
from exumi_data.cli.options import group

__all__ = ["app"]

app = group(
    "Begin a rig file, and check a rig before recording with it.",
    "exumi rig init exumi rig.toml",
    "exumi rig check rig.toml",
    no_args_is_help=True,
)
app.command("init", epilog=rig_init.EPILOG)(rig_init.run)
app.command("check", epilog=rig_check.EPILOG)(rig_check.run)
