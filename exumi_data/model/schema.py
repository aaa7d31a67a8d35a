"""JSON Schemas (2020-12), generated from the models."""

from typing import Any

from exumi_data.model.base import Model
from exumi_data.model.dataset import DatasetMetadata, SplitDocument
from exumi_data.model.episode import FORMAT_VERSION, DerivedMetadata, EpisodeMetadata
from exumi_data.model.manifest import Manifest

__all__ = ["DOCUMENTS", "json_schema"]

DOCUMENTS: dict[str, type[Model]] = {
    "episode": EpisodeMetadata,
    "derived": DerivedMetadata,
    "dataset": DatasetMetadata,
    "split": SplitDocument,
    "manifest": Manifest,
}


def json_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of one of `DOCUMENTS`."""
    schema = DOCUMENTS[name].model_json_schema(mode="validation")
    _close_maps(schema)
    # The models have defaults for these two, as a convenience in Python; in a file both must be.
    schema["required"] = ["format", "version", *schema.get("required", [])]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"https://exumi-data.org/schema/{FORMAT_VERSION}/{name}.schema.json",
        **schema,
    }


def _close_maps(schema: Any) -> None:
    """Let maps with named keys have no others: a pattern alone forbids nothing in JSON Schema."""
    if isinstance(schema, list):
        for item in schema:
            _close_maps(item)
    elif isinstance(schema, dict):
        if "patternProperties" in schema and "properties" not in schema:
            schema.setdefault("additionalProperties", False)
        for item in schema.values():
            _close_maps(item)
