"""What the harnesses share. Only Python's standard library: third parties run it."""

__all__: list[str] = []
