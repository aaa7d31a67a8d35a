"""The head of a dataset card: YAML that the Hugging Face hub reads."""

import re
from typing import Any

from exumi_data.catalog import CATALOG_NAME
from exumi_data.dataset import Dataset
from exumi_data.model.episode import UNKNOWN_LICENCE
from exumi_data.release.facts import Facts
from exumi_data.release.yaml_text import yaml_text

__all__ = ["header_of", "hub_licence"]

# https://huggingface.co/docs/hub/repositories-licenses: what the hub knows besides the lower case
# of SPDX's identifiers.
_RENAMED = {
    "ODC-By-1.0": "odc-by",
    "ODbL-1.0": "odbl",
    "PDDL-1.0": "pddl",
    "Zlib": "zlib",
    "PostgreSQL": "postgresql",
    "GFDL-1.3-only": "gfdl",
    "GFDL-1.3-or-later": "gfdl",
    "C-UDA-1.0": "c-uda",
}
_SAME = frozenset(
    [
        "apache-2.0",
        "mit",
        "cc0-1.0",
        "cc-by-2.0",
        "cc-by-2.5",
        "cc-by-3.0",
        "cc-by-4.0",
        "cc-by-sa-3.0",
        "cc-by-sa-4.0",
        "cc-by-nc-2.0",
        "cc-by-nc-3.0",
        "cc-by-nc-4.0",
        "cc-by-nd-4.0",
        "cc-by-nc-nd-3.0",
        "cc-by-nc-nd-4.0",
        "cc-by-nc-sa-2.0",
        "cc-by-nc-sa-3.0",
        "cc-by-nc-sa-4.0",
        "cdla-sharing-1.0",
        "cdla-permissive-1.0",
        "cdla-permissive-2.0",
        "wtfpl",
        "ecl-2.0",
        "epl-1.0",
        "epl-2.0",
        "etalab-2.0",
        "eupl-1.1",
        "eupl-1.2",
        "isc",
        "artistic-2.0",
        "bsl-1.0",
        "bsd-2-clause",
        "bsd-3-clause",
        "bsd-3-clause-clear",
        "afl-3.0",
        "lppl-1.3c",
        "ms-pl",
        "mpl-2.0",
        "ofl-1.1",
        "ncsa",
        "unlicense",
        "osl-3.0",
    ]  # read as a text
)
_GNU = re.compile(r"(AGPL|GPL|LGPL)-(2\.0|2\.1|3\.0)-(?:only|or-later)")
_GNU_KNOWN = frozenset(("agpl-3.0", "gpl-2.0", "gpl-3.0", "lgpl-2.1", "lgpl-3.0"))
_SIZES = (
    (1e3, "n<1K"),
    (1e4, "1K<n<10K"),
    (1e5, "10K<n<100K"),
    (1e6, "100K<n<1M"),
    (1e7, "1M<n<10M"),
    (1e8, "10M<n<100M"),
    (1e9, "100M<n<1B"),
)


def hub_licence(licence: str) -> str:
    """Return the hub's identifier of a licence.

    Parameters
    ----------
    licence : str
        As SPDX writes it.

    Returns
    -------
    str
        ``unknown`` where it is not known, ``other`` where the hub has no name for it.
    """
    if licence in (UNKNOWN_LICENCE, "NONE"):
        return "unknown"
    gnu = _GNU.fullmatch(licence)
    if gnu and f"{gnu[1]}-{gnu[2]}".lower() in _GNU_KNOWN:
        return f"{gnu[1]}-{gnu[2]}".lower()
    same = licence.lower()
    return _RENAMED.get(licence) or (same if same in _SAME else "other")


def header_of(dataset: Dataset, facts: Facts) -> str:
    """Return the YAML head, between its lines of dashes.

    Parameters
    ----------
    dataset : Dataset
    facts : Facts
        Of the dataset.
    """
    metadata = dataset.metadata
    licence = hub_licence(metadata.licence)
    kinds = dict.fromkeys(stream.kind for stream in facts.streams)
    known: dict[str, Any] = {"license": licence}
    if licence == "other":
        known |= {"license_name": metadata.licence.lower(), "license_link": "LICENSE"}
    known |= {
        "pretty_name": metadata.name,
        "task_categories": ["robotics"],
        "tags": ["exumi", "tactile", "manipulation", "zarr", *(k for k in kinds if ":" not in k)],
        "size_categories": [_size(len(dataset))],
        # The hub's viewer then shows what the episodes are; they themselves are no table.
        "configs": [{"config_name": "episodes", "data_files": CATALOG_NAME}],
    }
    known["tags"] = list(dict.fromkeys(known["tags"]))
    return "\n".join(["---", *(f"{key}: {_yaml(value)}" for key, value in known.items()), "---"])


def _size(count: int) -> str:
    return next((name for most, name in _SIZES if count < most), "n>1T")


def _yaml(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_yaml(one)}' for key, one in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(_yaml(one) for one in value)}]"
    # Plain words are easier to read.
    is_word = re.fullmatch(r"[a-z][a-z0-9.-]*[a-z0-9]", value) and value not in _NO_WORDS
    return value if is_word else yaml_text(value)


_NO_WORDS = frozenset(("yes", "no", "on", "off", "true", "false", "null"))
