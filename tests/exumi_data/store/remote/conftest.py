"""A dataset, and servers that hold it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from exumi_data.store.pack import pack
from exumi_data.store.remote import fetching, reading, requests
from tests.exumi_data.builders import write_dataset, write_episode
from tests.servers import S3, S3_ENVIRONMENT, Web, pack_dataset, web


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Nothing is known, and failures are given up soon."""
    monkeypatch.setenv("EXUMI_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(requests, "_RETRIES", 1)
    monkeypatch.setattr(
        requests, "_TIMEOUTS", {"connect_timeout": "1s", "read_timeout": "1s", "timeout": "1s"}
    )
    reading._readers.clear()
    requests._store.cache_clear()
    requests._without_ends.clear()
    yield
    reading._readers.clear()
    requests._store.cache_clear()


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of folders, the same one packed, and an episode of everything in both forms."""
    root = tmp_path_factory.mktemp("remote")
    write_dataset(root / "folders", 3)
    pack_dataset(root / "folders", root / "packed")
    pack(write_episode(root / "whole.zarr"))
    return root


@pytest.fixture(scope="session")
def s3_server(folders: Path) -> Iterator[S3]:
    server = S3()
    server.upload(folders / "packed", "packed")
    server.upload(folders / "folders", "folders")
    server.upload(folders / "whole.zarr", "whole.zarr")
    server.put("whole.zarr.zip", (folders / "whole.zarr.zip").read_bytes())
    yield server
    server.stop()


@pytest.fixture
def s3(s3_server: S3, monkeypatch: pytest.MonkeyPatch) -> S3:
    for name, value in S3_ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", s3_server.endpoint)
    return s3_server


@pytest.fixture
def site(folders: Path) -> Iterator[Web]:
    with web(folders) as server:
        yield server


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[requests.Request]:
    """The requests that are sent."""
    sent: list[requests.Request] = []
    original = requests.perform

    def note(request: requests.Request) -> requests.Answer:
        sent.append(request)
        return original(request)

    monkeypatch.setattr(fetching, "perform", note)
    return sent
