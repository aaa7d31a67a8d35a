"""URLs of remote data: taken apart, joined, and shown without their secrets."""

import os
import re
from dataclasses import dataclass
from urllib.parse import quote, unquote, urlsplit

from exumi_data.errors import UnsupportedError, UsageError
from exumi_data.redaction import without_secrets

__all__ = ["SCHEMES", "Address", "is_url", "join"]

SCHEMES = ("s3", "gs", "az", "http", "https")
_WEB = ("http", "https")
_LONGEST = 4096  # of a URL; what sends them panics at 65 thousand
_BUCKET = re.compile(r"[A-Za-z0-9$][A-Za-z0-9._-]*")
_BROKEN = re.compile(r"(s3|gs|az|https?):/(?!/)")


def is_url(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a URL.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    UsageError
        It was one, before `pathlib` took a slash of it.
    """
    text = os.fsdecode(path)
    if isinstance(path, os.PathLike) and _BROKEN.match(text):
        raise UsageError(
            "a URL cannot be given as a pathlib.Path, which drops a slash",
            where=text,
            fix="Give it as text.",
        )
    return "://" in text


@dataclass(frozen=True, slots=True)
class Address:
    """Where one remote object, or what begins with its name, is.

    Attributes
    ----------
    root : str
        The bucket or the host: ``s3://bucket``, ``https://host:8443``.
    key : str
        Path below it, without a slash at either end.
    query : str
        Of a signed URL; a secret.
    user : str
        ``user:password``, percent-encoded; a secret.
    """

    root: str
    key: str
    query: str = ""
    user: str = ""

    @property
    def scheme(self) -> str:
        """``s3``, ``gs``, ``az``, ``http`` or ``https``."""
        return self.root.partition("://")[0]

    @property
    def url(self) -> str:
        """The URL with its secrets: what opens the same thing again."""
        if self.scheme not in _WEB:
            return f"{self.root}/{self.key}"
        scheme, _, host = self.root.partition("://")
        user = f"{self.user}@" if self.user else ""
        query = f"?{self.query}" if self.query else ""
        return f"{scheme}://{user}{host}/{quote(self.key)}{query}"

    @property
    def shown(self) -> str:
        """The URL without its secrets, for messages."""
        return without_secrets(self.url)

    def below(self, path: str) -> "Address":
        """Return the address of something below this one.

        Parameters
        ----------
        path : str
            Relative, with ``/``; as it is, not percent-encoded.
        """
        key = f"{self.key}/{path}" if self.key else path
        return Address(self.root, key, self.query, self.user)

    @classmethod
    def parse(cls, url: str) -> "Address":
        """Take a URL apart.

        Parameters
        ----------
        url : str

        Raises
        ------
        UnsupportedError
            An unknown scheme.
        UsageError
            No bucket or host, credentials where they do not belong, or what no URL has.
        """
        if len(url) > _LONGEST or not url.isprintable():
            what = "longer than any URL" if url.isprintable() else "a URL with control characters"
            raise UsageError(what, where=ascii(without_secrets(url)[:100]))
        scheme, _, rest = url.partition("://")
        scheme = scheme.lower()
        if scheme not in SCHEMES:
            raise UnsupportedError(
                f"{scheme}:// is no kind of URL that is read",
                where=url,
                fix=f"There are {', '.join(f'{name}://' for name in SCHEMES)}, and local paths.",
            )
        return _of_web(url) if scheme in _WEB else _of_bucket(scheme, rest, url)


def _of_bucket(scheme: str, rest: str, url: str) -> Address:
    bucket, _, key = rest.partition("/")
    if not bucket or "@" in bucket:
        what = "a URL with credentials in it" if "@" in bucket else "no bucket is named"
        fix = "Credentials come from the environment. A URL is like s3://bucket/folder."
        raise UsageError(what, where=url, fix=fix)
    if not _BUCKET.fullmatch(bucket):
        what = "the name of a bucket has letters, digits, dots and hyphens only"
        raise UsageError(what, where=url, fix="A URL is like s3://bucket/folder.")
    return Address(f"{scheme}://{bucket}", _checked(key, url))


def _of_web(url: str) -> Address:
    try:
        parts = urlsplit(url)
        user, _, host = parts.netloc.rpartition("@")
        _ = parts.port  # raises where it is none
        path = unquote(parts.path, errors="strict")
    except ValueError as error:
        raise UsageError(f"not a URL ({error})", where=url) from None
    if not host or " " in host:
        raise UsageError("no host is named", where=url, fix="A URL is like https://host/folder.")
    if "#" in url:
        where = url.partition("#")[0]
        raise UsageError("a URL that has a #", where=where, fix="In the name of a file, write %23.")
    if "%2f" in parts.path.lower():  # which a request could not keep: it would ask for another file
        raise UsageError("a URL with %2F in its path, which is read as /", where=url)
    return Address(f"{parts.scheme}://{host}", _checked(path, url), parts.query, user)


def _checked(key: str, url: str) -> str:
    parts = key.strip("/").split("/")
    if parts != [""] and any(part in ("", ".", "..") for part in parts):
        raise UsageError("a URL with empty parts, . or .. in its path", where=url)
    return "/".join(parts)


def join(url: str, path: str) -> str:
    """Return the URL of something below another one; a query stays at the end.

    Parameters
    ----------
    url : str
    path : str
        Relative, with ``/``.
    """
    return Address.parse(url).below(path).url
