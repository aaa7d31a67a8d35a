"""Datasets and episodes in a bucket give what they give on the disk, in few requests."""

import json
import pickle
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import exumi_data
from exumi_data.errors import (
    ChangedDataError,
    DamagedDataError,
    MissingExtraError,
    NotAnEpisodeError,
    UnreachableError,
)
from exumi_data.stats import measure
from exumi_data.stats.summary import summarize
from exumi_data.store.access import open_stores
from exumi_data.store.digest import digest_of
from exumi_data.store.remote import reading, requests
from exumi_data.store.remote.requests import Request
from exumi_validators import validate
from tests.exumi_data.builders import read_everything
from tests.servers import S3


def dataset(path: str | Path) -> exumi_data.Dataset:
    found = exumi_data.open(path)
    assert isinstance(found, exumi_data.Dataset)
    return found


def episode(path: str | Path) -> exumi_data.Episode:
    found = exumi_data.open(path)
    assert isinstance(found, exumi_data.Episode)
    return found


@pytest.mark.parametrize("name", ["whole.zarr.zip", "whole.zarr"])
def test_an_episode_is_the_same_in_a_bucket(s3: S3, folders: Path, name: str) -> None:
    here, there = episode(folders / name), episode(f"s3://datasets/{name}")
    assert there.path == f"s3://datasets/{name}"
    assert there.metadata == here.metadata
    assert there.store.paths() == here.store.paths()
    assert digest_of(there.store) == digest_of(here.store)
    there.check_complete()
    for stream in here.streams.values():
        for array in stream.metadata.arrays:
            np.testing.assert_array_equal(there[stream.name].array(array), stream.array(array))
        if stream.is_image:
            np.testing.assert_array_equal(there[stream.name].frames[:], stream.frames[:])
    read_everything(Path(folders / name))  # the same steps, on the disk


def test_googles_protocol_is_read_as_well(
    s3: S3, folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its XML interface is that of S3, but for how requests are signed."""
    monkeypatch.setenv("GOOGLE_BASE_URL", s3.endpoint)
    monkeypatch.setenv("GOOGLE_BEARER_TOKEN", "anything")
    there = dataset("gs://datasets/packed")
    assert there.fingerprint == dataset(folders / "packed").fingerprint
    assert digest_of(episode("gs://datasets/whole.zarr").store) == digest_of(
        episode(folders / "whole.zarr").store
    )


def test_a_listing_and_an_answer_of_azures_name_one_version() -> None:
    known = {"last_modified": datetime.now(tz=UTC)}
    assert requests._tag({**known, "e_tag": '"0x24"'}) == requests._tag({**known, "e_tag": "0x24"})


@pytest.mark.parametrize(
    ("url", "variable", "value"),
    [
        ("az://lab/a", "AZURE_STORAGE_ENDPOINT", "http://127.0.0.1:1/name"),
        ("gs://lab/a", "GOOGLE_BASE_URL", "http://127.0.0.1:1"),
    ],
)
def test_endpoints_of_other_providers(
    url: str, variable: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_NAME", "name")
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", "%")
    monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT", "/nowhere")
    with pytest.raises(UnreachableError, match="cannot be opened") as caught:
        exumi_data.open(url)
    assert variable.partition("_")[0] in str(caught.value)
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_KEY", "AAAA")
    monkeypatch.delenv("GOOGLE_SERVICE_ACCOUNT")
    monkeypatch.setenv("GOOGLE_BEARER_TOKEN", "anything")
    requests._store.cache_clear()
    with pytest.raises(UnreachableError, match=f"cannot be reached.*{variable}"):
        exumi_data.open(url)


@pytest.mark.parametrize("name", ["packed", "folders"])
def test_a_dataset_is_the_same_in_a_bucket(s3: S3, folders: Path, name: str) -> None:
    here, there = dataset(folders / name), dataset(f"s3://datasets/{name}/")
    assert there.catalog == here.catalog
    assert there.fingerprint == here.fingerprint
    assert [one.root_sha256 for one in there] == [one.root_sha256 for one in here]
    assert there[here.ids[1]].id == here.ids[1]
    assert len(there.select(here.ids[:2])) == len(there[:2]) == 2
    mine, theirs = measure(here), measure(there)
    assert theirs.streams == mine.streams
    assert not theirs.unreadable
    assert summarize(there).path == f"s3://datasets/{name}"


def test_a_summary_of_an_episode(s3: S3, folders: Path) -> None:
    here, there = (
        summarize(episode(place))
        for place in (folders / "whole.zarr.zip", "s3://datasets/whole.zarr.zip")
    )
    assert there.bytes == here.bytes
    assert there.packed == here.packed is True


def test_packed_episodes_are_opened_with_two_requests_each(s3: S3, counted: list[Request]) -> None:
    found = dataset("s3://datasets/packed")
    locations = [found.episode_location(index) for index in range(3)]
    counted.clear()
    for store in open_stores(locations):
        with exumi_data.Episode(store) as opened:
            assert len(opened["tactile"].time) == 5
            assert opened["tactile"].activity is not None
    assert len(counted) <= 6
    assert {request.kind for request in counted} <= {"tail", "range"}


def test_what_was_read_is_not_asked_for_again(s3: S3, counted: list[Request]) -> None:
    first = episode("s3://datasets/whole.zarr.zip")
    frames = first["rgb"].frames[:] if "rgb" in first else first["tactile"].frames[:]
    counted.clear()
    again = episode("s3://datasets/whole.zarr.zip")
    name = "rgb" if "rgb" in again else "tactile"
    np.testing.assert_array_equal(again[name].frames[:], frames)
    assert [request.kind for request in counted] == ["tail"]  # is it the same still?


def test_validation_of_a_packed_episode(s3: S3, folders: Path) -> None:
    here = validate(folders / "whole.zarr.zip")
    there = validate("s3://datasets/whole.zarr.zip")
    assert there.path == "s3://datasets/whole.zarr.zip"
    assert there.codes() == here.codes()
    assert there.valid == here.valid
    with pytest.raises(exumi_data.ExumiError, match="Download it"):
        validate("s3://datasets/packed")


def test_stores_and_episodes_go_to_other_processes(s3: S3) -> None:
    found = episode("s3://datasets/whole.zarr.zip")
    again = pickle.loads(pickle.dumps(found))  # noqa: S301  # our own
    assert again.root_sha256 == found.root_sha256
    store = pickle.loads(pickle.dumps(found.store))  # noqa: S301
    assert store.identity == found.store.identity
    assert store.read("zarr.json") == found.store.read("zarr.json")
    folder = pickle.loads(pickle.dumps(episode("s3://datasets/whole.zarr").store))  # noqa: S301
    assert folder.read("zarr.json") == found.store.read("zarr.json")


def test_workers_of_a_pool_read_for_themselves(s3: S3) -> None:
    command = "-m exumi_data.cli stats s3://datasets/packed --workers 2 --quiet --format json"
    done = subprocess.run(
        [sys.executable, *command.split()], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["episodes"] == 3


@pytest.fixture
def own(s3: S3, folders: Path) -> Iterator[str]:
    """A packed episode that a test may change."""
    s3.put("own.zarr.zip", (folders / "whole.zarr.zip").read_bytes())
    yield "s3://datasets/own.zarr.zip"
    s3.remove("own.zarr.zip")


def test_an_object_that_changes_while_it_is_read(
    s3: S3, own: str, folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "0")
    opened = episode(own)
    changed = bytearray((folders / "whole.zarr.zip").read_bytes())
    changed[len(changed) // 2] ^= 1
    s3.put("own.zarr.zip", bytes(changed))
    reading._readers.clear()
    large = max(opened.store.paths(), key=opened.store.size)
    with pytest.raises(ChangedDataError, match="changed after it was opened") as caught:
        opened.store.read_range(large, 0, opened.store.size(large) // 2)
    assert caught.value.where == own


def test_an_object_that_is_removed_while_it_is_read(
    s3: S3, own: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "0")
    opened = episode(own)
    s3.remove("own.zarr.zip")
    reading._readers.clear()
    large = max(opened.store.paths(), key=opened.store.size)
    with pytest.raises(ChangedDataError, match="is gone"):
        opened.store.read_range(large, 0, opened.store.size(large) // 2)


@pytest.mark.parametrize("cut", [30, 5_000])
def test_a_zip_that_was_cut_short(s3: S3, folders: Path, cut: int) -> None:
    data = (folders / "whole.zarr.zip").read_bytes()
    s3.put("cut.zarr.zip", data[:-cut])
    with pytest.raises(DamagedDataError, match="not a readable zip"):
        exumi_data.open("s3://datasets/cut.zarr.zip")


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("s3://datasets/nothing", "neither a dataset"),
        ("s3://datasets/nothing.zarr.zip", "nothing of that name"),
        ("s3://datasets/nothing.zarr", "neither a dataset"),
        ("s3://datasets", "neither a dataset"),
    ],
)
def test_what_is_not_there(s3: S3, url: str, message: str) -> None:
    with pytest.raises(NotAnEpisodeError, match=message) as caught:
        exumi_data.open(url)
    assert url in str(caught.value)


def test_a_bucket_that_is_not_there(s3: S3) -> None:
    with pytest.raises(exumi_data.ExumiError, match="no such bucket") as caught:
        exumi_data.open("s3://no-such-bucket/a.zarr")
    assert "AWS_ENDPOINT_URL" in str(caught.value)


def test_a_dataset_without_a_catalog_is_refused(s3: S3, folders: Path) -> None:
    s3.put("bare/dataset.json", (folders / "packed" / "dataset.json").read_bytes())
    with pytest.raises(DamagedDataError, match=r"catalog\.parquet is missing") as caught:
        exumi_data.open("s3://datasets/bare")
    assert "exumi index" in str(caught.value)


def test_a_server_that_is_not_there(s3: S3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(UnreachableError, match="cannot be reached") as caught:
        exumi_data.open("s3://datasets/packed")
    assert "AWS_ENDPOINT_URL" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_obstore(s3: S3, monkeypatch: pytest.MonkeyPatch) -> None:
    requests._store.cache_clear()
    monkeypatch.setitem(__import__("sys").modules, "obstore.store", None)
    with pytest.raises(MissingExtraError, match=r"exumi-data\[cloud\]"):
        exumi_data.open("s3://datasets/packed")


def test_folders_that_consoles_show_are_no_files(s3: S3, folders: Path) -> None:
    for key in ("marked/whole.zarr/", "marked/whole.zarr/streams/", "marked/"):
        s3.put_marker(key)
    url = s3.upload(folders / "whole.zarr", "marked/whole.zarr")
    here, there = episode(folders / "whole.zarr"), episode(url)
    assert there.store.paths() == here.store.paths()
    assert digest_of(there.store) == digest_of(here.store)
