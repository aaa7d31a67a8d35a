"""Format ``umi``: the replay buffers that UMI and exUMI train on."""

from exumi_converters.umi.reading import UmiConverter
from exumi_converters.umi.writing import UmiExporter

__all__ = ["UmiConverter", "UmiExporter"]
