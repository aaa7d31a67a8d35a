"""Simulated devices that speak the real protocols, driven by a session whose truth is known."""

__all__: list[str] = []
