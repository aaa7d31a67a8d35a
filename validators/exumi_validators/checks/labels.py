"""Labels: provenance, ids, parts across splits."""

__all__: list[str] = []
