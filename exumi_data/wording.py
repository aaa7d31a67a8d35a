"""Counts, sizes and durations, written for people: the same in the terminal and on pages."""

__all__ = ["counted", "size_text", "time_text"]

_STEP = 1024


def counted(number: int, what: str) -> str:
    """Write a number of things: ``1 episode``, ``2,000 episodes``.

    Parameters
    ----------
    number : int
    what : str
        The thing; an s makes it several.
    """
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"


def size_text(size: float) -> str:
    """Write a number of bytes for people, such as ``3.4 MiB``."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if abs(size) < _STEP:
            return f"{size:.0f} B" if unit == "B" else f"{size:.1f} {unit}"
        size /= _STEP
    return f"{size:.1f} TiB"


def time_text(seconds: float) -> str:
    """Write a duration for people, such as ``1.2 ms``, ``5.04 s`` or ``2 h 05 min``."""
    if seconds < 1e-3:
        return f"{seconds * 1e6:.0f} µs"
    if seconds < 1:
        return f"{seconds * 1e3:.1f} ms"
    if seconds < 60:
        return f"{seconds:.2f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"
