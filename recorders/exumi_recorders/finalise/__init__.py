"""Finalising: a journal becomes an episode."""

__all__: list[str] = []
