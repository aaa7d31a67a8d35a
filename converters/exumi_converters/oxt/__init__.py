"""Format ``oxt``: the Zarr stores of Open-X-Tactile that FTP-1 trains from, both ways."""

__all__: list[str] = []
