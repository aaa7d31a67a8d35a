"""The manifest of a released dataset: ``manifest.json``."""

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from exumi_data.model.base import EpisodeId, Model, Sha256, Version
from exumi_data.model.episode import FORMAT_VERSION

__all__ = ["MANIFEST_FORMAT", "Manifest", "ManifestEpisode", "ManifestFile"]

MANIFEST_FORMAT = "exumi-manifest"

Path = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f]{1,1024}$")]


class ManifestFile(Model):
    """One file of the dataset."""

    path: Path
    """Relative to the dataset, with ``/``."""
    bytes: Annotated[int, Field(ge=0)]
    sha256: Sha256


class ManifestEpisode(Model):
    """One episode of the dataset."""

    id: EpisodeId
    path: Path
    """Of its folder or zip, relative to the dataset, with ``/``."""
    digest: Sha256
    """The digest of the episode, which does not depend on packing."""


class Manifest(Model):
    """``manifest.json``: every file of a released dataset, and every episode."""

    format: Literal["exumi-manifest"] = "exumi-manifest"
    version: Version = FORMAT_VERSION
    files: Annotated[list[ManifestFile], Field(fail_fast=True)]
    """Every file but the manifest itself and hidden ones."""
    episodes: Annotated[list[ManifestEpisode], Field(fail_fast=True)]
