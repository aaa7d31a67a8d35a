"""Metadata models: one module for each section of the standard.

The JSON Schemas in ``spec/schema`` are generated from these models (``exumi_data.model.schema``).
"""

from exumi_data.model.clock import Clock, Gap
from exumi_data.model.dataset import DatasetMetadata, MadeBy, SplitDocument
from exumi_data.model.description import (
    Annotations,
    CalibrationItem,
    Device,
    Embodiment,
    InputFile,
    Label,
    LossyStep,
    QualityNote,
    Segment,
    Source,
    Task,
)
from exumi_data.model.episode import (
    CONVENTION,
    CONVENTION_UUID,
    FORMAT_VERSION,
    UNKNOWN_LICENCE,
    DerivedItem,
    DerivedMetadata,
    EpisodeMetadata,
)
from exumi_data.model.images import ArrayImages, EncodedImages, Images, VideoFile, VideoImages
from exumi_data.model.streams import (
    ExtensionStream,
    Frames,
    PoseStream,
    RawData,
    Reference,
    RgbStream,
    Sensor,
    Stream,
    StreamModel,
    TactileStream,
    TaxelsStream,
    WidthStream,
    WrenchStream,
)

__all__ = [
    "CONVENTION",
    "CONVENTION_UUID",
    "FORMAT_VERSION",
    "UNKNOWN_LICENCE",
    "Annotations",
    "ArrayImages",
    "CalibrationItem",
    "Clock",
    "DatasetMetadata",
    "DerivedItem",
    "DerivedMetadata",
    "Device",
    "Embodiment",
    "EncodedImages",
    "EpisodeMetadata",
    "ExtensionStream",
    "Frames",
    "Gap",
    "Images",
    "InputFile",
    "Label",
    "LossyStep",
    "MadeBy",
    "PoseStream",
    "QualityNote",
    "RawData",
    "Reference",
    "RgbStream",
    "Segment",
    "Sensor",
    "Source",
    "SplitDocument",
    "Stream",
    "StreamModel",
    "TactileStream",
    "Task",
    "TaxelsStream",
    "VideoFile",
    "VideoImages",
    "WidthStream",
    "WrenchStream",
]
