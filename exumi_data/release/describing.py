"""What describes a finished dataset, written into its folder: card, citation, Croissant."""

import json
import os
from collections.abc import Sequence
from pathlib import Path

from exumi_data.dataset import open_dataset
from exumi_data.release.card import CARD_NAME, Finding, card_of
from exumi_data.release.citation import CITATION_NAME, Edition, cff_of
from exumi_data.release.croissant import CROISSANT_NAME, croissant_of
from exumi_data.store.files import write_atomic

__all__ = ["describe"]


def describe(
    root: str | os.PathLike[str],
    findings: Sequence[Finding] | None = None,
    *,
    edition: Edition | None = None,
    repository: str | None = None,
    workers: int | None = None,
) -> list[str]:
    """Write ``README.md`` with its pictures, ``CITATION.cff`` and ``croissant.json``.

    This comes before the manifest, which lists them: they say nothing of it. Without authors there
    is no ``CITATION.cff``.

    Parameters
    ----------
    root : path-like
        The dataset's folder, with its catalog.
    findings : sequence of Finding, optional
        Of the validator; None: it was not asked.
    edition : Edition, optional
        Which edition it is, where ``dataset.json`` does not say.
    repository : str, optional
        ``owner/name`` on the Hugging Face hub.
    workers : int, optional
        Processes that measure.

    Returns
    -------
    list of str
        What was written, below the folder.

    Raises
    ------
    ExumiError
        The dataset cannot be read; nothing was written.
    OSError
        Something cannot be written.
    """
    folder = Path(root)
    metadata = open_dataset(folder).metadata
    card = card_of(folder, findings, edition=edition, repository=repository, workers=workers)
    citation = cff_of(metadata, edition)
    croissant = json.dumps(croissant_of(folder, edition=edition), indent=1, ensure_ascii=False)
    files = {**card.pictures, CARD_NAME: card.text.encode()}
    if citation is not None:
        files[CITATION_NAME] = citation.encode()
    files[CROISSANT_NAME] = f"{croissant}\n".encode()
    for name, content in files.items():
        write_atomic(folder / name, content)
    return list(files)
