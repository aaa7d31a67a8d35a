"""Statistics of an episode or a dataset: rates, gaps, activity, usability, sizes, labels.

>>> from exumi_data.stats import measure
>>> statistics = measure(exumi_data.open("my-dataset"))  # doctest: +SKIP
>>> statistics.active.ratio  # doctest: +SKIP
0.55

A `Statistics` is plain data: ``dataclasses.asdict`` gives what ``exumi stats --format json``
prints.
"""

from exumi_data.stats.measuring import measure
from exumi_data.stats.model import (
    ActiveTactile,
    Content,
    Labels,
    Range,
    Regime,
    Sizes,
    Statistics,
    StreamStatistics,
    Unreadable,
    Usable,
)
from exumi_data.stats.summary import DatasetSummary, EpisodeSummary, StreamRow, summarize

__all__ = [
    "ActiveTactile",
    "Content",
    "DatasetSummary",
    "EpisodeSummary",
    "Labels",
    "Range",
    "Regime",
    "Sizes",
    "Statistics",
    "StreamRow",
    "StreamStatistics",
    "Unreadable",
    "Usable",
    "measure",
    "summarize",
]
