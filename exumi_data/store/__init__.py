"""Episodes on disk: access to files, Zarr v3 arrays, image encodings, writing, packing, digests."""

__all__: list[str] = []
