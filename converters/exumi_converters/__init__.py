"""Other formats to exUMI episodes, one module a format; and episodes to training sets.

>>> from exumi_converters import ConvertOptions, convert, prepare
>>> report = convert("videos", "my-dataset", from_format="octopi")  # doctest: +SKIP
>>> training = prepare("my-dataset", "my-training-set", size=224, gray=True)  # doctest: +SKIP
"""

from exumi_converters.conversion import convert
from exumi_converters.converter import (
    ConvertOptions,
    Discovery,
    EpisodeSource,
    NamedSplit,
    SourceFile,
)
from exumi_converters.prepare import prepare
from exumi_converters.registry import FORMATS, converters
from exumi_converters.report import ConversionReport, Failure, Flag, PrepareReport, Progress

__all__ = [
    "FORMATS",
    "ConversionReport",
    "ConvertOptions",
    "Discovery",
    "EpisodeSource",
    "Failure",
    "Flag",
    "NamedSplit",
    "PrepareReport",
    "Progress",
    "SourceFile",
    "convert",
    "converters",
    "prepare",
]
