"""Format ``umi``: the replay buffers that UMI and exUMI train on."""

__all__: list[str] = []
