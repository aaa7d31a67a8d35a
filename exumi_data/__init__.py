"""exUMI Data: the open standard and toolkit for tactile robot-manipulation data.

Import of this package loads numpy and pydantic only; everything else is loaded when it is used.
"""

from typing import TYPE_CHECKING, Any

from exumi_data._version import __version__
from exumi_data.dataset import CatalogWarning, Dataset
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import ExumiError
from exumi_data.opening import open  # the surface users meet: exumi_data.open(path)

if TYPE_CHECKING:
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


def __getattr__(name: str) -> Any:
    # The writer needs zstd and crc32c, which a reader of metadata does not.
    if name == "EpisodeWriter":
        from exumi_data.store.episode_writer import EpisodeWriter

        return EpisodeWriter
    msg = f"module 'exumi_data' has no attribute {name!r}"
    raise AttributeError(msg)
