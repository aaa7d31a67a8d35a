"""Drivers of devices, one module each; each is imported only when a rig names it."""

__all__: list[str] = []
