"""Streams against each other: latency estimated from the data, against the declared one."""

__all__: list[str] = []
