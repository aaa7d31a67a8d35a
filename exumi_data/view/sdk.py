"""Whether the Rerun SDK is there."""

from importlib.metadata import PackageNotFoundError, version

from exumi_data.errors import MissingExtraError

__all__ = ["require_rerun"]

_PACKAGE = "rerun-sdk"
_OLDEST = (0, 41)
_FIX = 'Install it: pip install "exumi-data[view]"'


def require_rerun() -> None:
    """Check that the Rerun SDK is installed, and new enough.

    Raises
    ------
    MissingExtraError
        It is not.
    """
    try:
        found = version(_PACKAGE)
    except PackageNotFoundError:
        raise MissingExtraError("looking at episodes needs the Rerun viewer", fix=_FIX) from None
    numbers = tuple(int(part) for part in found.split(".")[:2] if part.isdecimal())
    if numbers < _OLDEST:
        oldest = ".".join(map(str, _OLDEST))
        raise MissingExtraError(
            f"rerun-sdk {found} is too old: {oldest} or newer is needed", fix=_FIX
        )
