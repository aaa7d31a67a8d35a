"""How a dataset is to be cited: CITATION.cff and BibTeX.

What ``dataset.json`` does not say is left out; nothing is made up.
"""

import json
import re
from dataclasses import dataclass

from exumi_data.errors import UsageError
from exumi_data.model.dataset import DatasetMetadata
from exumi_data.model.episode import UNKNOWN_LICENCE

__all__ = ["CITATION_NAME", "Edition", "bibtex_of", "cff_of", "edition_of"]

CITATION_NAME = "CITATION.cff"

_DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])")
_SPDX_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")
_DOI = re.compile(r"\b10\.\d{4,9}/[^\s\"'<>{},;]*[^\s\"'<>{},;.]")
# Words that are no part of a person's name: such authors are entities.
_ENTITY = re.compile(
    r"\b(authors|center|centre|collaboration|consortium|contributors|foundation|group|inc|institute"
    r"|lab|laboratory|labs|ltd|project|team|university)\b",
    re.IGNORECASE,
)
_TEX = str.maketrans({c: rf"\{c}" for c in "&%$#_{}"} | {"\\": r"\textbackslash{}"})


@dataclass(frozen=True, slots=True)
class Edition:
    """Which edition of a dataset is cited.

    Attributes
    ----------
    version : str or None
        Of the data, ``major.minor.patch``.
    published : str or None
        The day, ``YYYY-MM-DD``.
    url : str or None
        Where it can be had.
    """

    version: str | None = None
    published: str | None = None
    url: str | None = None

    def __post_init__(self) -> None:
        if self.published is not None and not _DATE.fullmatch(self.published):
            raise UsageError(
                f"{self.published!r} is no day", fix="Write it as YYYY-MM-DD, such as 2026-03-01."
            )
        if self.url is not None and not re.fullmatch(r"https?://\S+", self.url):
            raise UsageError(f"{self.url!r} is no address", fix="It begins with https://.")


def edition_of(metadata: DatasetMetadata, edition: Edition | None = None) -> Edition:
    """Return which edition a dataset is: what is given, and else what ``dataset.json`` says.

    Parameters
    ----------
    metadata : DatasetMetadata
    edition : Edition, optional
    """
    given = edition or Edition()
    release = metadata.release
    return Edition(
        version=given.version or (release.version if release else None),
        published=given.published or (release.published if release else None),
        url=given.url,
    )


def cff_of(metadata: DatasetMetadata, edition: Edition | None = None) -> str | None:
    """Make a CITATION.cff (Citation File Format 1.2.0).

    Parameters
    ----------
    metadata : DatasetMetadata
    edition : Edition, optional

    Returns
    -------
    str or None
        None where no authors are named: the format has no file without them.
    """
    if not metadata.authors:
        return None
    about = edition_of(metadata, edition)
    lines = [
        "cff-version: 1.2.0",
        f"message: {_quoted('If you use this dataset, please cite it.')}",
        "type: dataset",
        f"title: {_quoted(metadata.name)}",
        "authors:",
    ]
    for author in metadata.authors:
        parts = [f"{key}: {_quoted(value)}" for key, value in _person(author).items()]
        lines += [f"  - {parts[0]}", *(f"    {part}" for part in parts[1:])]
    optional = {
        "abstract": metadata.description,
        "version": about.version,
        "date-released": about.published,
        "url": about.url,
        "license": _spdx(metadata.licence),
        "doi": _doi(metadata.citation),
    }
    lines += [f"{key}: {_quoted(value)}" for key, value in optional.items() if value]
    return "\n".join(lines) + "\n"


def bibtex_of(metadata: DatasetMetadata, edition: Edition | None = None) -> str:
    """Make the BibTeX entry of a dataset; its own citation, where it has one in BibTeX.

    Parameters
    ----------
    metadata : DatasetMetadata
    edition : Edition, optional

    Returns
    -------
    str
    """
    own = (metadata.citation or "").strip()
    if own.startswith("@") and own.endswith("}"):
        return own
    about = edition_of(metadata, edition)
    fields = {
        "title": "{" + _tex(metadata.name) + "}",
        "author": " and ".join(_bibtex_name(author) for author in metadata.authors),
        "year": about.published[:4] if about.published else "",
        "version": about.version or "",
        "url": about.url or "",
        "doi": _doi(own) or "",
        "note": _tex(" ".join(own.split())),
    }
    inner = "".join(f"  {key} = {{{value}}},\n" for key, value in fields.items() if value)
    return f"@misc{{{_key(metadata.name)},\n{inner}}}"


def _person(author: str) -> dict[str, str]:
    """Return an author's name as the format has it: ``Family, Given`` and ``Given Family``."""
    name, email = _without_email(author)
    found: dict[str, str] = {}
    if "," in name:
        family, _, given = name.partition(",")
        found = {"family-names": family.strip(), "given-names": given.strip()}
    elif " " in name and not _ENTITY.search(name):
        given, _, family = name.rpartition(" ")
        found = {"family-names": family, "given-names": given.strip()}
    named = {key: value for key, value in found.items() if value} or {"name": name}
    return named | ({"email": email} if email else {})


def _without_email(author: str) -> tuple[str, str | None]:
    match = re.fullmatch(r"\s*(.*?)\s*<([^<>\s]+@[^<>\s]+)>\s*", author)
    return (match[1], match[2]) if match and match[1] else (" ".join(author.split()), None)


def _bibtex_name(author: str) -> str:
    name = _without_email(author)[0]
    text = _tex(name)
    return f"{{{text}}}" if _ENTITY.search(name) and "," not in name else text


def _tex(text: str) -> str:
    return text.translate(_TEX)


def _key(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9-]+", "-", name).strip("-").lower() or "dataset"


def _spdx(licence: str) -> str | None:
    """Return a licence that the format knows: one of SPDX's, no expression, and not unknown."""
    is_one = _SPDX_ID.fullmatch(licence) and not licence.startswith("LicenseRef-")
    return licence if is_one and licence not in (UNKNOWN_LICENCE, "NONE") else None


def _doi(text: str | None) -> str | None:
    match = _DOI.search(text or "")
    return match[0] if match else None


def _quoted(text: str) -> str:
    """Return a text as a scalar of YAML: JSON's strings are YAML's."""
    return json.dumps(text, ensure_ascii=False)
