"""The journal: what is being recorded, on disk within milliseconds, and read back after a crash."""

__all__: list[str] = []
