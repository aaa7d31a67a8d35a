"""Documents of a dataset: ``dataset.json`` and ``splits/<name>.json``."""

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints

from exumi_data.model.base import EpisodeId, Identifier, Model, Version
from exumi_data.model.episode import FORMAT_VERSION

__all__ = [
    "DATASET_FORMAT",
    "SPLIT_NAME",
    "DatasetMetadata",
    "MadeBy",
    "Release",
    "SplitDocument",
]

DATASET_FORMAT = "exumi-dataset"

SPLIT_NAME = r"^[a-z0-9][a-z0-9_-]*$"

# Bounded, in a form that needs no braces: messages show it.
_NUMBER = "(0|[1-9][0-9]?[0-9]?[0-9]?[0-9]?[0-9]?)"
DatasetVersion = Annotated[
    str,
    StringConstraints(pattern=rf"^{_NUMBER}\.{_NUMBER}\.{_NUMBER}$"),
]


class MadeBy(Model):
    """How the dataset was made."""

    tool: Identifier
    tool_version: Identifier
    command: str | None = None
    settings: dict[str, Any] | None = None


Day = Annotated[str, Field(pattern=r"^[0-9]{4}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])$")]


class Release(Model):
    """Which release of a dataset this is."""

    version: DatasetVersion
    """Of the data, `major.minor.patch`: not that of the format."""
    previous: DatasetVersion | None = None
    """The release that `CHANGELOG.md` compares with."""
    published: Day | None = None
    """The day, `YYYY-MM-DD`."""
    url: Annotated[str, Field(pattern=r"^https?://\S+$", max_length=2048)] | None = None
    """Where it can be had."""


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
    release: Release | None = None
    """Of a released dataset only."""


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
