"""Simulated devices that speak the real protocols; all are driven by one known truth."""

__all__: list[str] = []
