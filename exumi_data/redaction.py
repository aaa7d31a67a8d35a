"""Secrets that stand in URLs never reach a message."""

import re

__all__ = ["without_secrets"]

_USER = re.compile(r"(\b[a-z][a-z0-9+.-]*://)[^/\s?#]*@", re.IGNORECASE)
_QUERY = re.compile(r"(\bhttps?://[^\s?#'\"<>]*)\?[^\s'\"<>]*", re.IGNORECASE)


def without_secrets(text: str) -> str:
    """Return a text whose URLs have neither user and password nor a query.

    Parameters
    ----------
    text : str
        A URL, or a message that holds some.

    Returns
    -------
    str

    Examples
    --------
    >>> without_secrets("https://me:word@host/x.zip?X-Amz-Signature=0123")
    'https://***@host/x.zip?***'
    """
    if "://" not in text:
        return text
    return _QUERY.sub(r"\1?***", _USER.sub(r"\1***@", text))
