"""Releases of datasets: packed, described, listed with their digests, compared, published."""

__all__: list[str] = []
