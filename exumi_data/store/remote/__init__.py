"""Episodes in object storage and behind web servers, read by ranges (extra ``cloud``)."""

__all__: list[str] = []
