"""Drivers of devices, one module each; each is imported only when a rig names it."""
