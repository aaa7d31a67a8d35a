"""PyTorch loaders: windows of tactile episodes on a common timeline.

Importing this package needs no torch; using a class does.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from exumi_data.errors import MissingExtraError

if TYPE_CHECKING:
    from exumi_loaders.active_sampler import ActiveWindowSampler
    from exumi_loaders.clips import Clip, Clips
    from exumi_loaders.concat import ConcatWindows
    from exumi_loaders.contrastive import BatchOrder, ContrastiveBatches
    from exumi_loaders.contrastive_loss import InfoNCE, info_nce
    from exumi_loaders.device.blur import Blur
    from exumi_loaders.device.colour import ColourJitter
    from exumi_loaders.device.jpeg import DecodeJpeg
    from exumi_loaders.device.mirror import Mirror
    from exumi_loaders.device.octopi import NormaliseSensor, OctopiImages
    from exumi_loaders.device.prefetch import prefetch_to_device
    from exumi_loaders.device.size import CentreCrop, PadToSquare, RandomCrop, Resize
    from exumi_loaders.device.to_float import ToFloat
    from exumi_loaders.instructions import InstructionSamples
    from exumi_loaders.normaliser import Normaliser
    from exumi_loaders.policy import PolicyWindows
    from exumi_loaders.policy_spec import PolicySpec
    from exumi_loaders.policy_stream import LateStreamError, PolicyStream
    from exumi_loaders.properties import PropertyWindows
    from exumi_loaders.representation import TactileRepresentation
    from exumi_loaders.retrieval.building import DamagedClip, Embedding, EncodedClips, encode_clips
    from exumi_loaders.retrieval.entries import Entry
    from exumi_loaders.retrieval.guessing import guessing_game
    from exumi_loaders.retrieval.index import TactileIndex
    from exumi_loaders.retrieval.matches import Match
    from exumi_loaders.retrieval.scoring import Score, evaluate, leave_one_out
    from exumi_loaders.retrieval.sorting import felt_rating, tactile_sorting
    from exumi_loaders.retrieval.verifying import verify_index
    from exumi_loaders.sampler import WindowIndex, WindowSampler
    from exumi_loaders.texture import TextureEncoder
    from exumi_loaders.timeline import Timeline, TimelineSettings, build_timeline
    from exumi_loaders.tpp import TPPWindows
    from exumi_loaders.two_views import TwoViews
    from exumi_loaders.vision import VisionEncoder

__all__ = [
    "ActiveWindowSampler",
    "BatchOrder",
    "Blur",
    "CentreCrop",
    "Clip",
    "Clips",
    "ColourJitter",
    "ConcatWindows",
    "ContrastiveBatches",
    "DamagedClip",
    "DecodeJpeg",
    "Embedding",
    "EncodedClips",
    "Entry",
    "InfoNCE",
    "InstructionSamples",
    "LateStreamError",
    "Match",
    "Mirror",
    "NormaliseSensor",
    "Normaliser",
    "OctopiImages",
    "PadToSquare",
    "PolicySpec",
    "PolicyStream",
    "PolicyWindows",
    "PropertyWindows",
    "RandomCrop",
    "Resize",
    "Score",
    "TPPWindows",
    "TactileIndex",
    "TactileRepresentation",
    "TextureEncoder",
    "Timeline",
    "TimelineSettings",
    "ToFloat",
    "TwoViews",
    "VisionEncoder",
    "WindowIndex",
    "WindowSampler",
    "build_timeline",
    "encode_clips",
    "evaluate",
    "felt_rating",
    "guessing_game",
    "info_nce",
    "leave_one_out",
    "prefetch_to_device",
    "tactile_sorting",
    "verify_index",
]

_HOME = {
    "ActiveWindowSampler": "active_sampler",
    "BatchOrder": "contrastive",
    "Blur": "device.blur",
    "CentreCrop": "device.size",
    "Clip": "clips",
    "Clips": "clips",
    "ColourJitter": "device.colour",
    "ConcatWindows": "concat",
    "ContrastiveBatches": "contrastive",
    "DamagedClip": "retrieval.building",
    "DecodeJpeg": "device.jpeg",
    "Embedding": "retrieval.building",
    "EncodedClips": "retrieval.building",
    "Entry": "retrieval.entries",
    "InfoNCE": "contrastive_loss",
    "InstructionSamples": "instructions",
    "LateStreamError": "policy_stream",
    "Match": "retrieval.matches",
    "Mirror": "device.mirror",
    "NormaliseSensor": "device.octopi",
    "Normaliser": "normaliser",
    "OctopiImages": "device.octopi",
    "PadToSquare": "device.size",
    "PolicySpec": "policy_spec",
    "PolicyStream": "policy_stream",
    "PolicyWindows": "policy",
    "PropertyWindows": "properties",
    "RandomCrop": "device.size",
    "Resize": "device.size",
    "Score": "retrieval.scoring",
    "TPPWindows": "tpp",
    "TactileIndex": "retrieval.index",
    "TactileRepresentation": "representation",
    "TextureEncoder": "texture",
    "Timeline": "timeline",
    "TimelineSettings": "timeline",
    "ToFloat": "device.to_float",
    "TwoViews": "two_views",
    "VisionEncoder": "vision",
    "WindowIndex": "sampler",
    "WindowSampler": "sampler",
    "build_timeline": "timeline",
    "encode_clips": "retrieval.building",
    "evaluate": "retrieval.scoring",
    "felt_rating": "retrieval.sorting",
    "guessing_game": "retrieval.guessing",
    "info_nce": "contrastive_loss",
    "leave_one_out": "retrieval.scoring",
    "prefetch_to_device": "device.prefetch",
    "tactile_sorting": "retrieval.sorting",
    "verify_index": "retrieval.verifying",
}


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        msg = f"module 'exumi_loaders' has no attribute {name!r}"
        raise AttributeError(msg)
    try:
        module = import_module(f"exumi_loaders.{home}")
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise MissingExtraError(
            f"exumi_loaders.{name} needs PyTorch", fix='Install it: pip install "exumi-data[train]"'
        ) from None
    return getattr(module, name)
