"""Simulated devices that speak the protocols of real ones; all are driven by one known truth."""

__all__: list[str] = []
