"""Calibration: that it is there, and not older than it may be."""

__all__: list[str] = []
