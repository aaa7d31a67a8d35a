"""Which format a source has: every converter is asked, none is tried out."""

from collections.abc import Mapping
from pathlib import Path

from exumi_converters.converter import Converter
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.errors import SourceError, UsageError

__all__ = ["detect_format", "unreadable"]


def detect_format(source: str | Path, known: Mapping[str, Converter]) -> tuple[str, str]:
    """Recognise the format of a source.

    Parameters
    ----------
    source : path-like
    known : mapping of str to Converter

    Returns
    -------
    name : str
    reason : str
        By what it was recognised.

    Raises
    ------
    SourceError
        It is not there, or no format is recognised.
    UsageError
        More than one is, or it is an exUMI dataset already.
    """
    path = Path(source)
    try:
        is_there, is_dataset = path.exists(), (path / DATASET_DOCUMENT).is_file()
    except OSError as error:
        raise unreadable(source, error) from None
    if not is_there:
        raise SourceError("no such file or folder", where=source)
    if is_dataset:
        raise UsageError(
            "this is an exUMI dataset already",
            where=source,
            fix="To write it in another format, say --to FORMAT (see exumi convert --list).",
        )
    found = {name: _recognised(name, converter, path) for name, converter in known.items()}
    reasons = {name: reason for name, reason in found.items() if reason is not None}
    if not reasons:
        formats = "; ".join(f"{name} ({item.describes})" for name, item in known.items())
        raise SourceError(
            "no format is recognised",
            where=source,
            fix=f"Say which with --from. Formats: {formats}.",
        )
    if len(reasons) > 1:
        named = "; ".join(f"{name} ({reason})" for name, reason in reasons.items())
        raise UsageError(
            f"it could be more than one format: {named}",
            where=source,
            fix="Say which with --from.",
        )
    return next(iter(reasons.items()))


def unreadable(source: str | Path, error: OSError) -> SourceError:
    """Return the error to raise where a source cannot be read.

    Parameters
    ----------
    source : path-like
    error : OSError
    """
    return SourceError(
        f"cannot be read ({error.strerror or error})",
        where=error.filename or source,
        fix="Check that it exists and that you may read it.",
    )


def _recognised(name: str, converter: Converter, path: Path) -> str | None:
    try:
        return converter.recognise(path)
    except OSError as error:
        raise unreadable(path, error) from None
    except Exception as error:
        raise SourceError(
            f"the format {name!r} fails to look at it ({type(error).__name__}: {error})",
            where=path,
            fix="Say with --from which format it is, and tell the authors of that one.",
        ) from error
