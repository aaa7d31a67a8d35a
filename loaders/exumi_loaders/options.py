"""Options that have to be one of a few words."""

from collections.abc import Iterable

from exumi_data.errors import UsageError

__all__ = ["one_of"]


def one_of(name: str, value: str, supported: Iterable[str]) -> None:
    """Refuse a value that is none of the supported ones.

    Parameters
    ----------
    name : str
        Of the option.
    value : str
    supported : iterable of str

    Raises
    ------
    UsageError
        Names the supported values.
    """
    words = tuple(supported)
    if value not in words:
        raise UsageError(
            f"invalid {name} ({value!r}). Supported values are {', '.join(map(repr, words))}"
        )
