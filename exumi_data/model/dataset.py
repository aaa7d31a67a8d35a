"""Documents of a dataset: ``dataset.json`` and ``splits/<name>.json``."""

from typing import Annotated, Any, Literal

from pydantic import Field

from exumi_data.model.base import EpisodeId, Identifier, Model, Version
from exumi_data.model.episode import FORMAT_VERSION

__all__ = [
    "DATASET_FORMAT",
    "SPLIT_NAME",
    "DatasetMetadata",
    "MadeBy",
    "SplitDocument",
]

DATASET_FORMAT = "exumi-dataset"

SPLIT_NAME = r"^[a-z0-9][a-z0-9_-]*$"


class MadeBy(Model):
    """How the dataset was made."""

    tool: Identifier
    tool_version: Identifier
    command: str | None = None
    settings: dict[str, Any] | None = None


class DatasetMetadata(Model):
    """``dataset.json``."""

    format: Literal["exumi-dataset"] = "exumi-dataset"
    version: Version = FORMAT_VERSION
    requires: list[Identifier] = []
    """Features without which it would be misread: a reader refuses unknown ones."""
    name: Identifier
    description: str | None = None
    licence: Identifier
    authors: list[str] = []
    citation: str | None = None
    splits: list[Annotated[str, Field(pattern=SPLIT_NAME)]] = []
    """Names of the files in ``splits/``."""
    made_by: MadeBy | None = None


class SplitDocument(Model):
    """``splits/<name>.json``: named lists of episode ids."""

    format: Literal["exumi-split"] = "exumi-split"
    version: Version = FORMAT_VERSION
    requires: list[Identifier] = []
    """Features without which it would be misread: a reader refuses unknown ones."""
    name: Annotated[str, Field(pattern=SPLIT_NAME)]
    level: Literal["episode", "object", "part"]
    """What is kept together: all episodes of an object or part fall into the same list."""
    seed: int | None = None
    method: str | None = None
    lists: dict[Identifier, Annotated[list[EpisodeId], Field(fail_fast=True)]]
