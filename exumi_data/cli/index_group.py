"""``exumi index``: the catalog of a dataset, and with a verb an index of touch."""

from typing import Any

from typer.core import TyperGroup

from exumi_data.cli import index, retrieval
from exumi_data.cli.options import group

__all__ = ["app"]


class _CatalogByDefault(TyperGroup):
    """A group in which a word that is no verb is a dataset, whose catalog is written."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the verb ``catalog`` before arguments that begin with none."""
        helps = ctx.help_option_names
        if not args or (args[0] not in self.commands and args[0] not in helps):
            args = ["catalog", *args]
        return list(super().parse_args(ctx, args))


app = group(
    "Write a dataset's catalog; or build and ask an index of what things feel like. "
    "`exumi index DATASET` is short for `exumi index catalog DATASET`.",
    "exumi index my-dataset",
    "exumi index build my-dataset my-index",
    "exumi index query my-index my-dataset --episode 0",
    cls=_CatalogByDefault,
)
app.command("catalog", epilog=index.EPILOG)(index.run)
app.command("build", epilog=retrieval.BUILD_EPILOG)(retrieval.build)
app.command("query", epilog=retrieval.QUERY_EPILOG)(retrieval.query)
app.command("teach", epilog=retrieval.TEACH_EPILOG)(retrieval.teach)
app.command("forget", epilog=retrieval.FORGET_EPILOG)(retrieval.forget)
app.command("info", epilog=retrieval.INFO_EPILOG)(retrieval.info)
app.command("eval", epilog=retrieval.EVAL_EPILOG)(retrieval.evaluate)
