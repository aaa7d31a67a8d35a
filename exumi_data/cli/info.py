"""``exumi info``."""

from dataclasses import asdict

from exumi_data.cli.options import DataArgument, Format, FormatOption, epilog

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi info my-dataset",
    "exumi info my-dataset/episodes/3f/0190a1b2-4c5d-7e8f-9a0b-1c2d3e4f503f.zarr",
    "exumi info my-dataset --format json",
    "exumi info s3://bucket/my-dataset",
)


def run(
    path: DataArgument,
    output: FormatOption = Format.TEXT,
) -> None:
    """Show what a dataset or an episode is, on one screen.

    A dataset is read from its catalog, an episode from its metadata: no data is read.
    """
    import exumi_data
    from exumi_data.cli.output import print_json, result_console
    from exumi_data.stats.summary import EpisodeSummary, summarize

    summary = summarize(exumi_data.open(path))
    if output is Format.JSON:
        print_json(asdict(summary))
    elif isinstance(summary, EpisodeSummary):
        from exumi_data.cli.info_text import print_episode

        print_episode(summary, result_console())
    else:
        from exumi_data.cli.info_text import print_dataset

        print_dataset(summary, result_console())
