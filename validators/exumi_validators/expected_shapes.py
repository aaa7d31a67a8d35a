"""Shapes that the registry asks for, with the words filled in by a stream's metadata."""

from exumi_data.model.streams import StreamModel, images_of
from exumi_data.standard import ArraySpec

__all__ = ["fits", "shape_words"]

_IMAGE_WORDS = ("height", "width", "channels")
_GRID_WORDS = ("rows", "columns")


def _size(word: str, stream: StreamModel | None) -> int | None:
    """Return the size that a word stands for; None where the data alone says it."""
    if word in _IMAGE_WORDS:
        # Sound has channels of its own.
        found = getattr(images_of(stream) or stream, word, None) if stream else None
        return None if found is None else int(found)
    if word == "components":
        return len(getattr(stream, "components", ()))
    if word in _GRID_WORDS:
        grid = getattr(stream, "grid", None)
        return None if grid is None else int(grid[_GRID_WORDS.index(word)])
    return None


def _allows(word: int | str, size: int, stream: StreamModel | None) -> bool:
    if isinstance(word, int):
        return size == word
    if word == "1|3":
        return size in (1, 3)
    wanted = _size(word, stream)
    return wanted is None or size == wanted


def fits(shape: tuple[int, ...], spec: ArraySpec, stream: StreamModel | None) -> bool:
    """Whether a shape is that of the registry, but for the number of samples.

    Parameters
    ----------
    shape : tuple of int
    spec : ArraySpec
    stream : StreamModel or None
        The stream that the array belongs to.
    """
    words = spec.shape
    if words[-1] == "...":
        words = words[:-1]
        shape = shape[: len(words)]
    return len(shape) == len(words) and all(
        _allows(word, size, stream) for word, size in zip(words, shape, strict=True)
    )


def shape_words(spec: ArraySpec, stream: StreamModel | None) -> str:
    """Write the shape that the registry asks for, such as ``[N, 480, 640, 3]``.

    Parameters
    ----------
    spec : ArraySpec
    stream : StreamModel or None
    """
    sizes = (_size(word, stream) if isinstance(word, str) else word for word in spec.shape)
    pairs = zip(spec.shape, sizes, strict=True)
    return f"[{', '.join(str(word if size is None else size) for word, size in pairs)}]"
