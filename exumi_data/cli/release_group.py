"""``exumi release``: a release of a dataset, and with a verb what becomes of it."""

from typing import Any

from typer.core import TyperGroup

from exumi_data.cli import release_build, release_diff, release_push, release_verify
from exumi_data.cli.options import group

__all__ = ["app"]


class _BuildByDefault(TyperGroup):
    """A group in which a word that is no verb is a dataset, of which a release is made."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the verb ``build`` before arguments that begin with none."""
        helps = ctx.help_option_names
        if not args or (args[0] not in self.commands and args[0] not in helps):
            args = ["build", *args]
        return list(super().parse_args(ctx, args))


app = group(
    "Make a release of a dataset, verify a copy of one, compare two, publish one. "
    "`exumi release SRC DST` is short for `exumi release build SRC DST`.",
    "exumi release my-dataset my-release --licence CC-BY-4.0 --licence-file CC-BY-4.0.txt",
    "exumi release verify my-release",
    "exumi release diff my-release-1.0.0 my-release-1.1.0",
    "exumi release push my-release our-lab/my-dataset",
    cls=_BuildByDefault,
)
app.command("build", epilog=release_build.EPILOG)(release_build.run)
app.command("verify", epilog=release_verify.EPILOG)(release_verify.run)
app.command("diff", epilog=release_diff.EPILOG)(release_diff.run)
app.command("push", epilog=release_push.EPILOG)(release_push.run)
