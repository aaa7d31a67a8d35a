"""Format ``mcap``: episodes as MCAP files with Foxglove's schemas, and such files as episodes."""

__all__: list[str] = []
