"""The checks, one module for each section of the standard."""

__all__: list[str] = []
