"""Fingertip temperature in exUMI episodes."""

__all__: list[str] = []
