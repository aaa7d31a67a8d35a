"""``dataset.json`` and the splits beside it, changed one file at a time."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.model.dataset import DatasetMetadata, SplitDocument
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, dump, parse_dataset
from exumi_data.store.files import write_atomic
from exumi_data.store.plain_files import read_plain

__all__ = ["change_dataset", "document_bytes", "write_splits"]


def change_dataset(
    root: Path, change: Callable[[DatasetMetadata], None], *, document: str = DATASET_DOCUMENT
) -> DatasetMetadata:
    """Change ``dataset.json``, if it changes.

    Parameters
    ----------
    root : pathlib.Path
    change : callable
        Changes the metadata in place.
    document : str
        Its name while the dataset is not finished.

    Returns
    -------
    DatasetMetadata
        After the change.
    """
    path = root / document
    metadata = parse_dataset(read_plain(path, MAX_DOCUMENT_BYTES), path)
    before = dump(metadata)
    change(metadata)
    if dump(metadata) != before:
        write_atomic(path, document_bytes(dump(metadata)))
    return metadata


def write_splits(
    root: Path, splits: Mapping[str, SplitDocument], *, document: str = DATASET_DOCUMENT
) -> None:
    """Write splits of a dataset, and name them in ``dataset.json``.

    Parameters
    ----------
    root : pathlib.Path
    splits : mapping of str to SplitDocument
        By name. Others that are there stay.
    document : str
        The name of ``dataset.json`` while the dataset is not finished.
    """
    for name, split in splits.items():
        path = root / "splits" / f"{name}.json"
        content = document_bytes(dump(split))
        if not path.exists() or read_plain(path, MAX_DOCUMENT_BYTES) != content:
            write_atomic(path, content)

    def name_them(metadata: DatasetMetadata) -> None:
        metadata.splits = [*metadata.splits, *(n for n in splits if n not in metadata.splits)]

    change_dataset(root, name_them, document=document)


def document_bytes(document: Mapping[str, object]) -> bytes:
    """Return a JSON document as it stands in a file: the same for the same document.

    Parameters
    ----------
    document : mapping
    """
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()
