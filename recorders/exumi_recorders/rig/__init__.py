"""The rig file: which devices there are, what their streams are called, how they are calibrated."""

__all__: list[str] = []
