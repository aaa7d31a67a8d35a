"""Format ``umi``: the replay buffers that UMI and exUMI train on."""
