"""Simulated devices that speak the real protocols, from a world whose truth is known."""

__all__: list[str] = []
