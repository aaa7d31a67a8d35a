"""Touch: activity, references, saturated, dark, frozen, swapped and damaged images."""

__all__: list[str] = []
