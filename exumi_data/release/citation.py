"""How a dataset is to be cited: CITATION.cff and BibTeX.

What ``dataset.json`` does not say is left out; nothing is made up.
"""

import re
from dataclasses import dataclass

from exumi_data.errors import UsageError
from exumi_data.model.dataset import DatasetMetadata
from exumi_data.model.episode import UNKNOWN_LICENCE
from exumi_data.release.yaml_text import yaml_text

__all__ = ["CITATION_NAME", "Edition", "bibtex_of", "cff_of", "edition_of"]

CITATION_NAME = "CITATION.cff"

_DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])")
_SPDX_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")
_DOI = re.compile(r"\b10\.\d{4,9}/[^\s\"'<>{},;]*[^\s\"'<>{},;.]")
_CFF_DOI = re.compile(r"10\.\d{4,9}(\.\d+)?/[A-Za-z0-9:/_;\-.()\[\]\\]+")
_CFF_EMAIL = re.compile(r"\S+@\S+\.\S{2,}")
# Of the format's list what data have; of others the address is told.
_LICENCES = re.compile(
    r"CC-BY(-NC|-NC-ND|-NC-SA|-ND|-SA)?-(1\.0|2\.0|2\.5|3\.0|4\.0)|CC0-1\.0|0BSD|AFL-3\.0|Apache-2\.0"
    r"|Artistic-2\.0|BSD-[23]-Clause|BSL-1\.0|C-UDA-1\.0|CDLA-(Permissive|Sharing)-1\.0|EPL-[12]\.0"
    r"|ECL-2\.0|EUPL-1\.[12]|ISC|MIT|MIT-0|MPL-2\.0|MS-PL|NCSA|O-UDA-1\.0|ODC-By-1\.0|ODbL-1\.0"
    r"|OFL-1\.1|OGL-UK-[123]\.0|OSL-3\.0|PDDL-1\.0|PostgreSQL|Unlicense|WTFPL|Zlib|etalab-2\.0"
    r"|A?GPL-3\.0-(only|or-later)|LGPL-(2\.1|3\.0)-(only|or-later)|GPL-2\.0-(only|or-later)"
    r"|GFDL-1\.3-(only|or-later)"
)
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
        url=given.url or (release.url if release else None),
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
    people = [_person(author) for author in metadata.authors if author.strip()]
    if not people:
        return None
    about = edition_of(metadata, edition)
    doi = _doi(metadata.citation)
    lines = [
        "cff-version: 1.2.0",
        f"message: {yaml_text('If you use this dataset, please cite it.')}",
        "type: dataset",
        f"title: {yaml_text(metadata.name)}",
        "authors:",
    ]
    for number, person in enumerate(people):
        if person in people[:number]:  # the format has nobody twice
            continue
        parts = [f"{key}: {yaml_text(value)}" for key, value in person.items()]
        lines += [f"  - {parts[0]}", *(f"    {part}" for part in parts[1:])]
    optional = {
        "abstract": metadata.description,
        "version": about.version,
        "date-released": about.published,
        "url": about.url,
        **_licence(metadata.licence),
        "doi": doi if doi and _CFF_DOI.fullmatch(doi) else None,
    }
    lines += [f"{key}: {yaml_text(value)}" for key, value in optional.items() if value]
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
    return named | ({"email": email} if email and _CFF_EMAIL.fullmatch(email) else {})


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


def _licence(licence: str) -> dict[str, str]:
    """Return the fields that say a licence: the format has a list of its own, older than SPDX's."""
    is_one = _SPDX_ID.fullmatch(licence) and not licence.startswith("LicenseRef-")
    if not is_one or licence in (UNKNOWN_LICENCE, "NONE"):
        return {}
    if _LICENCES.fullmatch(licence):
        return {"license": licence}
    return {"license-url": f"https://spdx.org/licenses/{licence.removesuffix('+')}.html"}


def _doi(text: str | None) -> str | None:
    match = _DOI.search(text or "")
    return match[0] if match else None
