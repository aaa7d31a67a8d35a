"""A dataset as Croissant 1.1 describes it: https://docs.mlcommons.org/croissant.

The records of `episodes` are the rows of the catalog. The description is made before the manifest
and says nothing of it: it names the catalog with its checksum, the catalog has the digest of each
episode, and the manifest lists the description itself like any other file.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from exumi_data.catalog import CATALOG_NAME, EPISODES_FOLDER, open_catalog
from exumi_data.dataset import DATASET_DOCUMENT, Dataset, open_dataset
from exumi_data.errors import UsageError
from exumi_data.manifest import sha256_of
from exumi_data.model.episode import UNKNOWN_LICENCE
from exumi_data.release.citation import Edition, bibtex_of, edition_of
from exumi_data.release.facts import Facts, facts_of
from exumi_data.release.responsible import responsible_of

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["CROISSANT_NAME", "croissant_of"]

CROISSANT_NAME = "croissant.json"

_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "name": {"@container": "@language"},
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
_CONFORMS_TO = ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"]
_JSON = "application/json"
_ZARR = "https://zarr-specs.readthedocs.io/en/latest/v3/core/index.html"
_TYPES = {"string": "sc:Text", "int64": "cr:Int64", "double": "cr:Float64", "bool": "sc:Boolean"}
_KNOWN_LISTS = {
    "train": "cr:TrainingSplit",
    "training": "cr:TrainingSplit",
    "val": "cr:ValidationSplit",
    "valid": "cr:ValidationSplit",
    "validation": "cr:ValidationSplit",
    "test": "cr:TestSplit",
}
"""What Croissant calls lists of splits that have one of its meanings."""
_MEANING = {
    "id": "Id of the episode: it stays, whatever of the episode changes.",
    "path": "Path of the episode below the dataset.",
    "revision": "Counts changes of the episode.",
    "root_sha256": "SHA-256 of the episode's own metadata document.",
    "derived_digest": "Digest of what was derived from the episode, and can be again.",
    "digest": "Digest of the episode, the same for a folder and for its packed form.",
    "bytes": "Size of the episode's files.",
    "start": "Epoch of the episode's times, UTC; null where the source does not know it.",
    "duration_s": "From the first to the last sample of any stream, seconds.",
    "regime": "How it was collected: demonstration, play or touch.",
    "task": "What was to be done.",
    "success": "Whether it was done; null where nobody said.",
    "licence": "Licence of the episode, as SPDX writes it.",
    "object_id": "The object that was touched.",
    "part_id": "The part of the object.",
    "instance_id": "Which of several alike.",
    "trial": "Which repetition.",
    "procedure": "Exploratory procedure, such as press, slide or twist.",
    "pad_type": "Surface of the gel.",
    "labels": "Judgements of the object: property, and a number or a text.",
    "quality": "Codes of notes on quality.",
    "streams": "The episode's streams: samples, first and last time in ns, active tactile frames.",
}


def croissant_of(
    root: str | os.PathLike[str], base_url: str | None = None, *, edition: Edition | None = None
) -> dict[str, Any]:
    """Describe a finished dataset in Croissant's JSON-LD. Nothing is written.

    The same dataset gives the same description. What ``dataset.json`` does not say is left out:
    Croissant recommends a licence, a version and the day of publication.

    Parameters
    ----------
    root : path-like
        The dataset's folder, with its catalog.
    base_url : str, optional
        Where the dataset's files can be had. Without it they lie beside the description.
    edition : Edition, optional
        Which edition it is, where ``dataset.json`` does not say.

    Returns
    -------
    dict

    Raises
    ------
    UsageError
        There is no catalog.
    ExumiError
        The dataset cannot be read.
    """
    folder = Path(root)
    dataset = open_dataset(folder)
    metadata = dataset.metadata
    about = edition_of(metadata, edition)
    facts = facts_of(dataset)
    optional = {
        "description": metadata.description or _description(dataset, facts),
        "url": about.url,
        "license": _licence(metadata.licence),
        "version": about.version,
        "datePublished": about.published,
        "creator": [{"@type": "sc:Person", "name": name} for name in metadata.authors],
        "keywords": ["robotics", "manipulation", "tactile sensing", "exUMI", "Zarr"],
        **responsible_of(dataset, facts),
    }
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": metadata.name,
        "conformsTo": _CONFORMS_TO,
        "citeAs": bibtex_of(metadata, about),
        **{key: value for key, value in optional.items() if value},
        "distribution": [*_files(folder, dataset, base_url), *_file_sets(dataset)],
        "recordSet": [_episodes(folder), *_splits(dataset)],
    }


def _description(dataset: Dataset, facts: Facts) -> str:
    kinds = dict.fromkeys(stream.kind for stream in facts.streams)
    return (
        f"{len(dataset)} episodes of robot manipulation in the exUMI Episode format, with streams "
        f"of these kinds: {', '.join(kinds) or 'none'}."
    )


def _licence(licence: str) -> str:
    is_one = licence.replace("-", "").replace(".", "").replace("+", "").isalnum()
    # What is unknown is said to be unknown.
    known = is_one and not licence.startswith("LicenseRef-") and licence != UNKNOWN_LICENCE
    return f"https://spdx.org/licenses/{licence}.html" if known else licence


def _files(root: Path, dataset: Dataset, base_url: str | None) -> Iterator[dict[str, Any]]:
    if not (root / CATALOG_NAME).is_file():
        raise UsageError(
            "there is no catalog, whose rows are the records of the description",
            where=root,
            fix=f"Write it with: exumi index {root}",
        )
    paths = {CATALOG_NAME: CATALOG_NAME, DATASET_DOCUMENT: DATASET_DOCUMENT}
    # A file for each of its lists: mlcroissant reads a file in one way only.
    paths |= {_list_file(n, part): f"splits/{n}.json" for n, part in _lists(dataset)}
    for place_id, path in paths.items():
        checksum, size = sha256_of(root / path)
        place = quote(path)
        yield {
            "@type": "cr:FileObject",
            "@id": place_id,
            "name": path.rpartition("/")[2],
            "contentUrl": f"{base_url.rstrip('/')}/{place}" if base_url else place,
            "contentSize": f"{size} B",
            "encodingFormat": "application/x-parquet" if path == CATALOG_NAME else _JSON,
            "sha256": checksum,
        }


def _file_sets(dataset: Dataset) -> Iterator[dict[str, Any]]:
    paths = dataset.catalog.column("path").to_pylist()
    forms = (
        ("packed-episodes", ".zarr.zip", "application/zip", "*.zarr.zip", "one stored zip each"),
        ("episode-folders", ".zarr", _ZARR, "*.zarr/*", "a folder each"),
    )
    for name, suffix, media_type, pattern, how in forms:
        if any(path.endswith(suffix) for path in paths):
            yield {
                "@type": "cr:FileSet",
                "@id": name,
                "name": name,
                "description": f"The episodes, {how}: Zarr v3 groups.",
                "encodingFormat": media_type,
                "includes": f"{EPISODES_FOLDER}/*/{pattern}",
            }


def _episodes(root: Path) -> dict[str, Any]:
    with open_catalog(root) as file:
        schema = file.schema_arrow
    return {
        "@type": "cr:RecordSet",
        "@id": "episodes",
        "name": "episodes",
        "description": "One record an episode: what the catalog says of it.",
        "key": {"@id": "episodes/id"},
        "field": [_field("episodes", column) for column in schema],
    }


def _field(parent: str, column: "pa.Field") -> dict[str, Any]:
    import pyarrow as pa

    place = f"{parent}/{column.name}"
    made: dict[str, Any] = {"@type": "cr:Field", "@id": place, "name": column.name}
    if column.name in _MEANING:
        made["description"] = _MEANING[column.name]
    kind = column.type
    if pa.types.is_list(kind):
        made |= {"isArray": True, "arrayShape": "-1"}
        kind = kind.value_type
    if pa.types.is_struct(kind):
        made["subField"] = [_sub_field(place, column.name, one) for one in kind]
        return made
    return made | {"dataType": _TYPES[str(kind)], "source": _column(column.name)}


def _sub_field(parent: str, column: str, part: "pa.Field") -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"{parent}/{part.name}",
        "name": part.name,
        "dataType": _TYPES[str(part.type)],
        "source": {**_column(column), "transform": {"jsonPath": part.name}},
    }


def _column(name: str) -> dict[str, Any]:
    return {"fileObject": {"@id": CATALOG_NAME}, "extract": {"column": name}}


def _splits(dataset: Dataset) -> Iterator[dict[str, Any]]:
    rows = [
        {
            "splits/name": f"{name}/{part}",
            "splits/url": _KNOWN_LISTS.get(part.lower()),
            "splits/level": split.level,
            "splits/episodes": len(ids),
            "splits/record_set": _list_id(name, part),
        }
        for name, split in dataset.splits.items()
        for part, ids in split.lists.items()
    ]
    if not rows:
        return
    types = {
        "name": "sc:Text",
        "url": "sc:URL",  # the specification says cr:Split, which mlcroissant refuses of a field
        "level": "sc:Text",
        "episodes": "cr:Int64",
        "record_set": "sc:Text",
    }
    yield {
        "@type": "cr:RecordSet",
        "@id": "splits",
        "name": "splits",
        "description": "The lists that the episodes are divided into, and the record set of each. "
        "All episodes of what `level` names are in the same list.",
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [
            {"@type": "cr:Field", "@id": f"splits/{name}", "name": name, "dataType": kind}
            for name, kind in types.items()
        ],
        "data": rows,
    }
    yield from (_list(name, part) for name, part in _lists(dataset))


def _lists(dataset: Dataset) -> Iterator[tuple[str, str]]:
    for name, split in dataset.splits.items():
        yield from ((name, part) for part in split.lists)


def _list_id(split: str, part: str) -> str:
    return f"splits/{split}/{quote(part, safe='')}"


def _list_file(split: str, part: str) -> str:
    return f"{_list_id(split, part)}/file"


def _list(split: str, part: str) -> dict[str, Any]:
    place = _list_id(split, part)
    return {
        "@type": "cr:RecordSet",
        "@id": place,
        "name": f"{split}/{part}",
        "description": f"Ids of the episodes in list {part!r} of the split {split!r}.",
        "field": {
            "@type": "cr:Field",
            "@id": f"{place}/id",
            "name": "id",
            "dataType": "sc:Text",
            "source": {
                "fileObject": {"@id": _list_file(split, part)},
                "extract": {"jsonPath": f"$.lists.{_json_path(part)}[*]"},
            },
        },
    }


def _json_path(name: str) -> str:
    quote_mark = "'" if '"' in name else '"'
    return f"{quote_mark}{name}{quote_mark}"
