"""One request to a remote object through obstore, and what its failure means in words."""

import base64
import json
import os
from datetime import timedelta
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from urllib.parse import unquote

from exumi_data.errors import (
    DamagedDataError,
    ExumiError,
    LimitError,
    MissingExtraError,
    UnreachableError,
)
from exumi_data.redaction import without_secrets
from exumi_data.store.remote.address import Address

if TYPE_CHECKING:
    from obstore.store import ObjectStore

__all__ = ["Answer", "Request", "perform", "store_of"]

Kind = Literal["range", "tail", "whole", "head", "list"]

MOST_LISTED = 100_000
"""Objects of one listing: an episode has a hundred."""
_TIMEOUTS = {"connect_timeout": "5s", "read_timeout": "20s", "timeout": "120s"}
_AZURE_HOST = ".blob.core.windows.net"
_without_ends: set[str] = set()
"""Web servers that were seen to refuse the request for an object's end: asked so once only."""
_RETRIES = 4
_RETRY_S = 60
_ENDPOINTS = {
    "s3": ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT"),
    "gs": ("GOOGLE_BASE_URL",),
    "az": ("AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT"),
}
"""Where another server is named than the provider's own; obstore itself reads most of them."""
_LOOK_AT = {
    "s3": "AWS_ENDPOINT_URL, AWS_REGION",
    "gs": "GOOGLE_BASE_URL",
    "az": "AZURE_STORAGE_ACCOUNT_NAME, AZURE_STORAGE_ENDPOINT",
}
_CREDENTIALS = {
    "s3": "Set AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION (and AWS_ENDPOINT_URL where "
    "it is not Amazon's); for a public bucket AWS_SKIP_SIGNATURE=true.",
    "gs": "Set GOOGLE_APPLICATION_CREDENTIALS to the file of a service account; for a public "
    "bucket GOOGLE_SKIP_SIGNATURE=true.",
    "az": "Set AZURE_STORAGE_ACCOUNT_NAME, and AZURE_STORAGE_ACCOUNT_KEY or "
    "AZURE_STORAGE_SAS_TOKEN.",
}
_CREDENTIAL_HOSTS = ("169.254.169.254", "metadata.google.internal")
_WEB_CREDENTIALS = "Give user and password in the URL (user:password@ in front of the host), or a "
_WEB_CREDENTIALS += "URL that is signed and has not expired."


class Request(NamedTuple):
    """What is asked of a server.

    Attributes
    ----------
    kind : {"range", "tail", "whole", "head", "list"}
        `length` bytes from `start`; the last `length` bytes; all of an object of at most `length`
        bytes; only what is known of it; what there is below a key.
    """

    kind: Kind
    address: Address
    start: int = 0
    length: int = 0


class Answer(NamedTuple):
    """What a server said.

    Attributes
    ----------
    data : bytes
        Of ``list``, a JSON list of (key, size, tag).
    size : int
        Of the whole object.
    tag : str
        Its ETag, or where there is none when it was last modified: another object has another one.
        Empty where the server says neither.
    """

    data: bytes
    size: int
    tag: str


def perform(request: Request) -> Answer:
    """Send a request and wait for its answer. Memory is bounded, whatever the server sends.

    Parameters
    ----------
    request : Request

    Raises
    ------
    FileNotFoundError
        There is no such object.
    UnreachableError
        The server does not answer, does not let us in, or cannot send parts of objects.
    LimitError
        The object is longer than asked for.
    """
    store = store_of(request.address)
    from obstore.exceptions import BaseError  # there is a store, so there is obstore

    try:
        if request.kind == "list":
            return _list(store, request.address)
        if request.kind == "tail":
            return _tail(store, request)
        return _get(store, request)
    except FileNotFoundError:
        raise FileNotFoundError(request.address.shown) from None
    except (BaseError, ValueError, OSError) as error:
        raise _explained(error, request.address) from None


def store_of(address: Address) -> "ObjectStore":
    """Return obstore's store of an address's bucket or host, as the environment says.

    Parameters
    ----------
    address : Address

    Raises
    ------
    MissingExtraError
        obstore is not installed.
    UnreachableError
        What the environment says makes no store.
    """
    return _store(address.root, address.query, address.user)


@lru_cache(maxsize=64)
def _store(root: str, query: str, user: str) -> "ObjectStore":
    """Return the store of a bucket or host; obstore keeps its connections."""
    try:
        from obstore.exceptions import BaseError
        from obstore.store import HTTPStore, from_url
    except ImportError:
        raise MissingExtraError(
            "URLs are read with the package obstore, which is not installed",
            fix='Install it with: pip install "exumi-data[cloud]"',
        ) from None
    client: dict[str, Any] = dict(_TIMEOUTS)
    named = _ENDPOINTS.get(root.partition("://")[0], ())
    endpoint = next((os.environ[name] for name in named if os.environ.get(name)), "")
    if root.startswith("http://") or endpoint.startswith("http://"):
        client["allow_http"] = True  # who writes http:// means it
    if user:
        # In a header and not in the URL: libraries name URLs in their messages.
        encoded = base64.b64encode(unquote(user).encode()).decode()
        client["default_headers"] = {"Authorization": f"Basic {encoded}"}
    options: dict[str, Any] = {}
    if root.startswith("s3://") and endpoint:  # of the three, obstore does not read all
        options["config"] = {"endpoint": endpoint}
    backoff = {
        "init_backoff": timedelta(seconds=0.1),
        "max_backoff": timedelta(seconds=5),
        "base": 2,
    }
    retries = {
        "max_retries": _RETRIES,
        "retry_timeout": timedelta(seconds=_RETRY_S),
        "backoff": backoff,
    }
    # `from_url` would take a signed URL of Amazon's for a bucket, and ask for credentials.
    # Its overloads are by the kind of URL, which is not known here.
    make: Any = HTTPStore.from_url if root.startswith("http") else from_url
    try:
        store: ObjectStore = make(
            f"{root}?{query}" if query else root,
            client_options=client,
            retry_config=retries,
            **options,
        )
        return store
    except (BaseError, ValueError) as error:  # nothing was asked of a server yet
        address = Address(root, "", query, user)
        said = without_secrets(str(error).partition("\n")[0])[:200]
        fix = _CREDENTIALS.get(address.scheme, "Look at the URL.")
        raise UnreachableError(f"cannot be opened ({said})", where=address.shown, fix=fix) from None


def _get(store: "ObjectStore", request: Request) -> Answer:
    import obstore

    address = request.address
    if request.kind == "head":
        meta = obstore.head(store, address.key)
        return Answer(b"", meta["size"], _tag(meta))
    options: Any = None
    if request.kind == "range":
        options = {"range": (request.start, request.start + request.length)}
    elif request.kind == "tail":
        options = {"range": {"suffix": request.length}}
    result = obstore.get(store, address.key, options=options)
    meta = result.meta
    encoding = str(result.attributes.get("Content-Encoding", ""))
    if encoding not in ("", "identity"):
        raise UnreachableError(
            f"the server sends it compressed (Content-Encoding: {encoding[:40]}), of which no part "
            "can be read",
            where=address.shown,
            fix="Upload it as it is, and switch compression off for these files.",
        )
    if request.kind == "whole" and meta["size"] > request.length:
        raise LimitError(f"the file has more than {request.length:,} bytes", where=address.shown)
    parts, got = [], 0
    for part in result.stream(min_chunk_size=1 << 20):
        parts.append(bytes(part))
        got += len(parts[-1])
        if got > request.length:
            raise UnreachableError(
                "the server sends more than it was asked for",
                where=address.shown,
                fix="Download the data, and give the local path.",
            )
    if request.kind != "range" and got != min(request.length, meta["size"]):
        raise UnreachableError(
            f"the server sent {got:,} of {min(request.length, meta['size']):,} bytes",
            where=address.shown,
            fix="Try again; if it stays, download the data.",
        )
    return Answer(b"".join(parts), meta["size"], _tag(meta))


def _tail(store: "ObjectStore", request: Request) -> Answer:
    """Get the end of an object in one request, or in two where a server knows ranges but no ends.

    Azure is such a server, and is met behind signed URLs as well.
    """
    root = request.address.root
    if request.address.scheme == "az" or root.endswith(_AZURE_HOST) or root in _without_ends:
        return _tail_by_size(store, request)
    try:
        return _get(store, request)
    except Exception as error:
        if request.address.scheme not in ("http", "https") or not _may_know_no_ends(error):
            raise
    answer = _tail_by_size(store, request)
    _without_ends.add(root)
    return answer


def _may_know_no_ends(error: Exception) -> bool:
    text = str(error)
    return type(error).__name__ == "NotSupportedError" or _status(text) in (400, 416, 501)


def _tail_by_size(store: "ObjectStore", request: Request) -> Answer:
    known = _get(store, request._replace(kind="head"))
    start = max(0, known.size - request.length)
    if start == known.size:
        return known
    return _get(store, Request("range", request.address, start, known.size - start))


def _tag(meta: Any) -> str:
    # Where the server does not say when, obstore says 1970.
    known = meta["e_tag"] or (meta["last_modified"].timestamp() and meta["last_modified"])
    return str(known or "").replace('"', "")  # Azure's listings do not quote it, its answers do


def _list(store: "ObjectStore", address: Address) -> Answer:
    import obstore

    if address.scheme in ("http", "https"):
        raise UnreachableError(
            "a web server cannot list what it has",
            where=address.shown,
            fix="Pack episodes (exumi pack), and write the catalog (exumi index) before upload.",
        )
    found = []
    for group in obstore.list(store, f"{address.key}/" if address.key else None):
        found += [(meta["path"], meta["size"], _tag(meta)) for meta in group]
        if len(found) > MOST_LISTED:
            raise LimitError(f"more than {MOST_LISTED:,} objects", where=address.shown)
    return Answer(json.dumps(found).encode(), len(found), "")


def _explained(error: Exception, address: Address) -> ExumiError:
    """Say what went wrong in one line; obstore's own message has pages, and secrets."""
    name = type(error).__name__
    text = str(error)
    first = without_secrets(text.partition("\n")[0])[:200]
    what, fix = f"cannot be read ({first})", "Try again; if it stays, download the data."
    if name in ("PermissionDeniedError", "UnauthenticatedError"):
        code = 403 if name == "PermissionDeniedError" else 401
        what = f"access was denied ({code})"
        fix = _CREDENTIALS.get(address.scheme, _WEB_CREDENTIALS)
    elif address.scheme in _CREDENTIALS and any(host in text for host in _CREDENTIAL_HOSTS):
        what, fix = "there are no credentials", _CREDENTIALS[address.scheme]
    elif name == "NotSupportedError":
        what = "the server cannot send parts of a file (range requests)"
        fix = "Put the data on one that can (S3, nginx, Apache), or download it."
    elif "kind: Timeout" in text or "operation timed out" in text:
        what = "the server did not answer in time"
        fix = "Look whether it can be reached from here, and try again."
    elif "kind: Connect" in text or "dns error" in text:
        what = "the server cannot be reached"
        fix = "Look at the name of the host, the network and its proxies, and try again."
        if address.scheme in _LOOK_AT:
            fix = f"Look at {_LOOK_AT[address.scheme]} and the network, and try again."
    elif "status: 416" in text or "InvalidRangeRequest" in text:
        return DamagedDataError("is shorter than it was", where=address.shown)
    elif "following redirect" in text:
        what, fix = "the server sends on without end", "Look at the URL."
    elif "Body" in text or "IncompleteMessage" in text:
        what = "the answer was cut short, each time it was asked for"
    elif (status := _status(text)) is not None:
        what, fix = f"the server answered with status {status}", "Try again later."
        if status == 404:  # of a listing
            what = "there is no such bucket"
            fix = f"Look at the URL, and at {_LOOK_AT.get(address.scheme, 'the server')}."
    return UnreachableError(what, where=address.shown, fix=fix)


def _status(text: str) -> int | None:
    _, _, rest = text.partition("status code: ")
    return int(rest[:3]) if rest[:3].isdecimal() else None
