"""A session: episodes one after the other, under the eyes and ears of an operator."""

__all__: list[str] = []
