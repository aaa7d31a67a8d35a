"""Retrieval by touch: an index of clips, queried by what they feel like."""

__all__: list[str] = []
