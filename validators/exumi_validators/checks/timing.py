"""Times and clocks as signals: rates, gaps, jitter, steps, drift, overlap."""

__all__: list[str] = []
