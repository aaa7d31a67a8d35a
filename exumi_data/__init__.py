"""exUMI Data: the open standard and toolkit for tactile robot-manipulation data.

Import of this package costs nothing: each name is loaded when it is first used, and that loads
numpy and pydantic only. Everything heavier waits until it is needed.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from exumi_data._version import __version__

if TYPE_CHECKING:
    from exumi_data.dataset import CatalogWarning, Dataset
    from exumi_data.episode import Episode, StreamView
    from exumi_data.errors import ExumiError
    from exumi_data.opening import open
    from exumi_data.store.episode_writer import EpisodeWriter

__all__ = [
    "CatalogWarning",
    "Dataset",
    "Episode",
    "EpisodeWriter",
    "ExumiError",
    "StreamView",
    "__version__",
    "open",
]

_HOME = {
    "CatalogWarning": "exumi_data.dataset",
    "Dataset": "exumi_data.dataset",
    "Episode": "exumi_data.episode",
    "EpisodeWriter": "exumi_data.store.episode_writer",
    "ExumiError": "exumi_data.errors",
    "StreamView": "exumi_data.episode",
    "open": "exumi_data.opening",
}


def __getattr__(name: str) -> Any:
    # Programs that only look at the version, or print their help, load no model.
    if name not in _HOME:
        msg = f"module 'exumi_data' has no attribute {name!r}"
        raise AttributeError(msg)
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value
