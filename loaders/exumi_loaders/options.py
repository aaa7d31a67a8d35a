"""What is asked of arguments, said before anything is done with them."""

from collections.abc import Iterable

from exumi_data.dataset import Dataset
from exumi_data.errors import UsageError

__all__ = ["one_of", "require_dataset"]


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


def require_dataset(found: object) -> None:
    """Refuse what is no dataset, such as a path or a single episode.

    Parameters
    ----------
    found : object

    Raises
    ------
    UsageError
    """
    if not isinstance(found, Dataset):
        raise UsageError(
            f"not a dataset, but {type(found).__name__}",
            fix="Give what exumi_data.open() makes of the folder that holds dataset.json.",
        )
