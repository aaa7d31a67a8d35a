"""Format ``lerobot``: datasets of LeRobot v3.0, written from episodes and read as episodes."""

__all__: list[str] = []
