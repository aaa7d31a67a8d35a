"""PyTorch loaders: windows of tactile episodes on a common timeline.

Importing this package needs no torch; using a class does.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from exumi_data.errors import MissingExtraError

if TYPE_CHECKING:
    from exumi_loaders.active_sampler import ActiveWindowSampler
    from exumi_loaders.concat import ConcatWindows
    from exumi_loaders.normaliser import Normaliser
    from exumi_loaders.policy import PolicyWindows
    from exumi_loaders.policy_spec import PolicySpec
    from exumi_loaders.policy_stream import LateStreamError, PolicyStream
    from exumi_loaders.representation import TactileRepresentation
    from exumi_loaders.sampler import WindowIndex, WindowSampler
    from exumi_loaders.timeline import Timeline, TimelineSettings, build_timeline
    from exumi_loaders.tpp import TPPWindows

__all__ = [
    "ActiveWindowSampler",
    "ConcatWindows",
    "LateStreamError",
    "Normaliser",
    "PolicySpec",
    "PolicyStream",
    "PolicyWindows",
    "TPPWindows",
    "TactileRepresentation",
    "Timeline",
    "TimelineSettings",
    "WindowIndex",
    "WindowSampler",
    "build_timeline",
]

_HOME = {
    "ActiveWindowSampler": "active_sampler",
    "ConcatWindows": "concat",
    "LateStreamError": "policy_stream",
    "Normaliser": "normaliser",
    "PolicySpec": "policy_spec",
    "PolicyStream": "policy_stream",
    "PolicyWindows": "policy",
    "TPPWindows": "tpp",
    "TactileRepresentation": "representation",
    "Timeline": "timeline",
    "TimelineSettings": "timeline",
    "WindowIndex": "sampler",
    "WindowSampler": "sampler",
    "build_timeline": "timeline",
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
