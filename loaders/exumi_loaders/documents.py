"""The JSON documents that loaders keep beside a dataset: read with limits, written whole."""

from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from exumi_data.errors import MetadataError, UsageError
from exumi_data.model.base import Model
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, check_version, load_json, problems_of
from exumi_data.store.files import write_atomic
from exumi_data.store.plain_files import read_plain

__all__ = ["read_document", "write_beside"]

M = TypeVar("M", bound=Model)


def read_document(model: type[M], source: Path | str | bytes, expected_format: str) -> M:
    """Read a document.

    Parameters
    ----------
    model : type
    source : pathlib.Path, str or bytes
        A file, or the document itself.
    expected_format : str

    Raises
    ------
    MetadataError, UnsupportedError
    """
    where = source if isinstance(source, Path) else expected_format
    if isinstance(source, Path):
        raw = read_plain(source, MAX_DOCUMENT_BYTES)
    else:
        raw = source.encode() if isinstance(source, str) else source
    newer = check_version(load_json(raw, where), expected_format, where)
    try:
        return model.model_validate_json(raw, context={"newer_minor": newer})
    except ValidationError as error:
        problems = tuple(f"{message} @ {path}" for message, path in problems_of(error))
        raise MetadataError(problems[0], where=where, problems=problems) from None


def write_beside(document: Model, path: Path) -> None:
    """Write a document to a file, but never into an episode or a dataset.

    Parameters
    ----------
    document : Model
    path : pathlib.Path

    Raises
    ------
    UsageError
        The file would lie within a dataset or an episode.
    """
    for folder in path.absolute().resolve().parents:
        if (folder / "dataset.json").exists() or folder.suffix == ".zarr":
            raise UsageError(
                f"would be written into the dataset {folder}, whose content it is no part of",
                where=path,
                fix="Keep it beside the dataset, with the weights that it belongs to.",
            )
    write_atomic(path, document.model_dump_json(indent=1).encode() + b"\n")
