"""Neutral descriptions of the valid episodes: what a writer is given to write.

The format is in ``spec/conformance/README.md``.
"""

import copy
import itertools
import json
from typing import Any

import numpy as np

from corpus.case import Case
from corpus.draft import Draft

__all__ = ["describable", "description"]

_OF_WRITERS = ("kind", "arrays")


def describable(case: Case) -> bool:
    """Whether a case is an episode of 1.0 that a writer can be asked to write."""
    return case.draft is not None and case.draft.metadata["version"] == "1.0"


def description(case: Case) -> dict[str, bytes]:
    """Return the files of a description."""
    draft = case.draft
    if draft is None:
        msg = f"{case.name} was not made from a draft"
        raise ValueError(msg)
    files: dict[str, bytes] = {}
    document = {
        "description": 1,
        "about": case.about,
        "episode": _episode(draft),
        "streams": [_stream(draft, name, files) for name in draft.metadata["streams"]],
        "derived": _derived(draft, files),
        "arrays": {
            path: _array(draft, path, files)
            for path in draft.values
            if path.startswith("calibration/")
        },
    }
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    return {"description.json": text.encode(), **files}


def _episode(draft: Draft) -> dict[str, Any]:
    own = ("format", "version", "streams")
    return {key: value for key, value in draft.metadata.items() if key not in own}


def _stream(draft: Draft, name: str, files: dict[str, bytes]) -> dict[str, Any]:
    model = copy.deepcopy(draft.metadata["streams"][name])
    arrays = list(model["arrays"])
    found: dict[str, Any] = {"name": name, "kind": model["kind"]}
    encoding = model.get("images", {}).get("encoding")
    cut = {"encoded": ("data", "offset", "crc32c"), "video": ("data", "offset")}.get(encoding, ())
    found["fields"] = {key: value for key, value in model.items() if key not in _OF_WRITERS}
    base = f"streams/{name}"
    found["arrays"] = {
        array: _array(draft, f"{base}/{array}", files) for array in arrays if array not in cut
    }
    if cut:
        names = _cut(draft, base, encoding, files)
        found["frames" if encoding == "encoded" else "videos"] = names
    return found


def _cut(draft: Draft, base: str, encoding: str, files: dict[str, bytes]) -> list[str]:
    """Add the frame or video files of a stream; return their names."""
    data = draft.values[f"{base}/data"].tobytes()
    edges = [int(edge) for edge in draft.values[f"{base}/offset"]]
    suffix = "jpg" if encoding == "encoded" else "video"
    names = []
    for index, (start, stop) in enumerate(itertools.pairwise(edges)):
        names.append(f"{base}/{index}.{suffix}")
        files[names[-1]] = data[start:stop]
    return names


def _derived(draft: Draft, files: dict[str, bytes]) -> list[dict[str, Any]]:
    group = draft.nodes.get("derived", {}).get("attributes", {}).get("exumi", {})
    return [
        {
            "stream": key.partition("/")[0],
            "name": key.partition("/")[2],
            "fields": item,
            "array": _array(draft, f"derived/{key}", files),
        }
        for key, item in group.get("items", {}).items()
    ]


def _array(draft: Draft, path: str, files: dict[str, bytes]) -> dict[str, Any]:
    """Add an array's bytes; return how they are to be read."""
    values: np.ndarray = draft.values[path]
    little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    files[f"{path}.bin"] = little.tobytes()
    return {"file": f"{path}.bin", "dtype": values.dtype.name, "shape": list(values.shape)}
