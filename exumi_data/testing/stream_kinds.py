"""The contract of a third party's stream kind."""

import json
import os
from typing import Any

import numpy as np
from pydantic import ValidationError

from exumi_data.episode import StreamView, open_episode
from exumi_data.extensions import StreamKind, find_stream_kind, mistakes_of_kind

__all__ = ["check_stream_kind"]


def check_stream_kind(kind: StreamKind, episode: str | os.PathLike[str]) -> None:
    """Check a kind's description, and that an episode has a stream that is as it says.

    Parameters
    ----------
    kind : StreamKind
    episode : path-like
        An episode with at least one stream of the kind, with all its required arrays.

    Raises
    ------
    AssertionError
        With all that is wrong.
    """
    found = mistakes_of_kind(kind)
    if find_stream_kind(kind.name, kind.version) is None:
        found.append(f"no installed package registers {kind.name} {kind.version}")
    found += _mistakes_of_schema(kind)
    with open_episode(episode) as opened:
        streams = {n: s for n, s in opened.streams.items() if s.kind == kind.name}
        if not streams:
            found.append(f"the episode has no stream of the kind {kind.name}")
        for name, stream in streams.items():
            found += [f"{name}: {mistake}" for mistake in _mistakes_of_stream(kind, stream)]
    if found:
        raise AssertionError("\n".join(found))


def _mistakes_of_schema(kind: StreamKind) -> list[str]:
    schema = kind.metadata.model_json_schema()
    lacking = sorted(kind.keys - set(schema["properties"]))
    return [f"the JSON Schema lacks {key}" for key in lacking]


def _mistakes_of_stream(kind: StreamKind, stream: StreamView) -> list[str]:
    document = json.loads(stream.metadata.model_dump_json(exclude_unset=True, by_alias=True))
    found = []
    if document["extension_version"] != kind.version:
        found.append(f"it is of version {document['extension_version']}, not {kind.version}")
    if document["schema_url"] != kind.schema_url:
        found.append(f"its schema_url is {document['schema_url']}, not {kind.schema_url}")
    try:
        kind.metadata.model_validate_json(json.dumps(document))
    except ValidationError as error:
        found.append(f"its metadata is not as described: {error}")
    found += _mistakes_of_arrays(kind, stream)
    found += _takes_anything(kind, document)
    return found


def _mistakes_of_arrays(kind: StreamKind, stream: StreamView) -> list[str]:
    found = []
    for spec in kind.arrays:
        if spec.name not in stream.metadata.arrays:
            if spec.required:
                found.append(f"it lacks the array {spec.name}")
            continue
        values: np.ndarray = stream.array(spec.name)
        if values.dtype.name not in spec.dtype:
            found.append(f"{spec.name} is {values.dtype.name}, not {' or '.join(spec.dtype)}")
        if spec.per_sample and len(values) != len(stream):
            found.append(f"{spec.name} has {len(values)} rows, the stream {len(stream)} samples")
    return found


def _takes_anything(kind: StreamKind, document: dict[str, Any]) -> list[str]:
    """Whether a required key may be missing all the same."""
    found = []
    for key in kind.metadata.model_json_schema().get("required", []):
        if key not in kind.keys:
            continue
        spoiled = {name: value for name, value in document.items() if name != key}
        try:
            kind.metadata.model_validate_json(json.dumps(spoiled))
        except ValidationError:
            continue
        found.append(f"metadata without {key} is taken, though it is required")
    return found
