"""Recording: devices are read in threads of their own, their samples written to a journal."""

__all__: list[str] = []
