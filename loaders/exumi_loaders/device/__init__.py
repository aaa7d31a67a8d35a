"""On the device: what is done with whole batches, as torch modules.

Each takes a batch as the loaders give it, a dict of tensors by name, and returns a new one. So
they stand in a ``torch.nn.Sequential``, and run wherever the batch lies.
"""

from exumi_loaders.device.arms import Arms
from exumi_loaders.device.blur import Blur
from exumi_loaders.device.colour import ColourJitter
from exumi_loaders.device.image_module import Batch, ImageModule
from exumi_loaders.device.jpeg import DecodeJpeg
from exumi_loaders.device.jpeg_frames import JpegFrames
from exumi_loaders.device.mirror import Mirror, mirror_relative_poses
from exumi_loaders.device.octopi import (
    OCTOPI_SENSORS,
    NormaliseSensor,
    OctopiImages,
    octopi_sensor,
)
from exumi_loaders.device.prefetch import DeviceBatches, prefetch_to_device
from exumi_loaders.device.size import CentreCrop, PadToSquare, RandomCrop, Resize
from exumi_loaders.device.to_float import ToFloat
from exumi_loaders.representation import TactileRepresentation

__all__ = [
    "OCTOPI_SENSORS",
    "Arms",
    "Batch",
    "Blur",
    "CentreCrop",
    "ColourJitter",
    "DecodeJpeg",
    "DeviceBatches",
    "ImageModule",
    "JpegFrames",
    "Mirror",
    "NormaliseSensor",
    "OctopiImages",
    "PadToSquare",
    "RandomCrop",
    "Resize",
    "TactileRepresentation",
    "ToFloat",
    "mirror_relative_poses",
    "octopi_sensor",
    "prefetch_to_device",
]
