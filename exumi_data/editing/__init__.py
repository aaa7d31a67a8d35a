"""Changing datasets and episodes that are finished: a new revision, or a new dataset."""

__all__: list[str] = []
