"""Clips of a camera that no hub stamps: containers, telemetry, markers in their frames."""

__all__: list[str] = []
