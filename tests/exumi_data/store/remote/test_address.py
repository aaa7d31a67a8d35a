"""URLs are taken apart, put together again, and never shown with their secrets."""

import pickle
from pathlib import Path

import pytest

from exumi_data.errors import DamagedDataError, UnsupportedError, UsageError
from exumi_data.redaction import without_secrets
from exumi_data.store.remote.address import Address, is_url, join

SIGNED = "https://me:pass%40word@host:8443/a%20b/x.zarr.zip?X-Amz-Signature=SECRET&y=1"


@pytest.mark.parametrize(
    "url",
    ["s3://bucket/a/b c#d?e", "gs://bucket/a", "az://container/a", "https://host/a/b", SIGNED],
)
def test_a_url_stays_what_it_is(url: str) -> None:
    assert Address.parse(url).url == url


def test_parts_of_a_signed_url() -> None:
    address = Address.parse(SIGNED)
    assert address.root == "https://host:8443"
    assert address.key == "a b/x.zarr.zip"
    assert address.query == "X-Amz-Signature=SECRET&y=1"
    assert address.user == "me:pass%40word"
    assert address.shown == "https://***@host:8443/a%20b/x.zarr.zip?***"


def test_a_query_stays_at_the_end() -> None:
    assert join("https://host/set?sig=1", "episodes/a b.zip") == (
        "https://host/set/episodes/a%20b.zip?sig=1"
    )
    assert join("s3://bucket", "dataset.json") == "s3://bucket/dataset.json"
    assert join("s3://bucket/set/", "dataset.json") == "s3://bucket/set/dataset.json"


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("ftp://host/a", "no kind of URL"),
        ("s3:///a", "no bucket"),
        ("https:///a", "no host"),
        ("s3://key:secret@bucket/a", "credentials"),
        ("s3://bucket/a/../b", "empty parts"),
        ("https://host/a/%2e%2e/b", "empty parts"),
        ("s3://bucket/a//b", "empty parts"),
        ("s3://my bucket/a", "letters, digits"),
        ("https://host:port/a?secret", "not a URL"),
        ("https://[::1/a?secret", "not a URL"),
        ("https://host/%ff", "not a URL"),
        ("https://my host/a", "no host"),
        ("https://host/a#b?secret", "write %23"),
        ("https://host/a%2Fb?secret", "%2F in its path"),
        ("s3://bucket/a\nb", "control characters"),
        ("https://host/\ud800", "control characters"),
        ("https://me:secret@host/" + "a" * 5000, "longer than any URL"),
        ("file:///a", "local paths"),
    ],
)
def test_what_is_refused(url: str, message: str) -> None:
    with pytest.raises((UsageError, UnsupportedError), match=message) as caught:
        Address.parse(url)
    assert "secret" not in str(caught.value)


def test_a_url_given_as_a_path_is_told_apart() -> None:
    assert is_url("s3://bucket/a")
    assert not is_url("data/a")
    assert not is_url(Path("data/s3:/a"))
    with pytest.raises(UsageError, match="drops a slash"):
        is_url(Path("s3://bucket/a"))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (
            "GET http://me:word@host/a?sig=1 in 3 ms (https://host/b?x)",
            "GET http://***@host/a?*** in 3 ms (https://host/b?***",
        ),
        ("{'url': 'https://host/b?x', 'y': 1}", "{'url': 'https://host/b?***', 'y': 1}"),
        ("http://me:p@ss@host/a@b", "http://***@host/a@b"),
        ("a@b.org asked: why?", "a@b.org asked: why?"),
        ("s3://bucket/a@b?c", "s3://bucket/a@b?c"),
    ],
)
def test_secrets_are_taken_out_of_texts(text: str, shown: str) -> None:
    assert without_secrets(text) == shown


def test_no_error_holds_a_secret() -> None:
    error = DamagedDataError(f"{SIGNED} is bad", where=SIGNED, fix=f"See {SIGNED}.")
    for one in (error, pickle.loads(pickle.dumps(error))):  # noqa: S301  # our own
        assert "SECRET" not in str(one)
        assert "word" not in str(one)
