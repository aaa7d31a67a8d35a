"""JSON documents as the toolkit writes them."""

import json
from typing import Any

__all__ = ["to_json"]


def to_json(document: dict[str, Any]) -> bytes:
    """Write a JSON object, readable for people."""
    return (json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
