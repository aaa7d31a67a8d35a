"""``exumi dataset``: changing datasets that are finished."""

from exumi_data.cli import (
    dataset_merge,
    dataset_rate,
    dataset_relabel,
    dataset_remove,
    dataset_select,
    dataset_split,
    dataset_trim,
)
from exumi_data.cli.options import group

__all__ = ["app"]

app = group(
    "Merge, select, split and correct datasets. Every change is one new file or episode, there "
    "whole or not at all; --dry-run tells what would change.",
    "exumi dataset select my-dataset good --where success=true",
    "exumi dataset relabel my-dataset --where task=pres --task press",
    "exumi dataset rate my-dataset 8f21 --failure --note dropped='It fell'",
    name="dataset",
    no_args_is_help=True,
)
app.command("merge", epilog=dataset_merge.EPILOG)(dataset_merge.run)
app.command("select", epilog=dataset_select.EPILOG)(dataset_select.run)
app.command("split", epilog=dataset_split.EPILOG)(dataset_split.run)
app.command("remove", epilog=dataset_remove.EPILOG)(dataset_remove.run)
app.command("trim", epilog=dataset_trim.EPILOG)(dataset_trim.run)
app.command("relabel", epilog=dataset_relabel.EPILOG)(dataset_relabel.run)
app.command("rate", epilog=dataset_rate.EPILOG)(dataset_rate.run)
