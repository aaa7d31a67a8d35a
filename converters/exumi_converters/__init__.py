"""Other formats to exUMI episodes and back, one module a format; and episodes to training sets.

>>> from exumi_converters import ConvertOptions, convert, export, prepare
>>> report = convert("videos", "my-dataset", from_format="octopi")  # doctest: +SKIP
>>> training = prepare("my-dataset", "my-training-set", size=224, gray=True)  # doctest: +SKIP
>>> written = export("my-dataset", "my-dataset-mcap", to_format="mcap")  # doctest: +SKIP
"""

from exumi_converters.conversion import convert, plan_conversion
from exumi_converters.converter import (
    Converter,
    ConvertOptions,
    Discovery,
    EpisodeSource,
    NamedSplit,
    SourceFile,
    SourceMembers,
)
from exumi_converters.exporter import Exporter, ExportItem, ExportOptions, ExportPlan, Loss, Part
from exumi_converters.exporting import export, plan_export
from exumi_converters.facets import FACETS, differences
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.prepare import prepare
from exumi_converters.registry import EXPORTERS, FORMATS, converters, exporters
from exumi_converters.report import (
    ConversionPlan,
    ConversionReport,
    ExportReport,
    Failure,
    Flag,
    PrepareReport,
    Progress,
)

__all__ = [
    "EXPORTERS",
    "FACETS",
    "FORMATS",
    "ConversionPlan",
    "ConversionReport",
    "ConvertOptions",
    "Converter",
    "Discovery",
    "EpisodeSource",
    "ExportItem",
    "ExportOptions",
    "ExportPlan",
    "ExportReport",
    "Exporter",
    "Failure",
    "Flag",
    "FormatOptions",
    "Loss",
    "NamedSplit",
    "Part",
    "PrepareReport",
    "Progress",
    "SourceFile",
    "SourceMembers",
    "convert",
    "converters",
    "differences",
    "export",
    "exporters",
    "parse_options",
    "plan_conversion",
    "plan_export",
    "prepare",
]
