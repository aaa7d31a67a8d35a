"""Web servers: good ones are read by ranges; of others it is said what is wrong with them."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import obstore
import pytest

import exumi_data
from exumi_data.errors import ChangedDataError, LimitError, NotAnEpisodeError, UnreachableError
from exumi_data.model.images import VideoImages
from exumi_data.store import images
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack
from exumi_data.store.remote import fetching, reading, requests
from exumi_data.store.remote.address import Address
from exumi_data.store.remote.download import download
from exumi_data.store.remote.reading import Identity, RemoteFile, Span
from exumi_data.store.remote.requests import Answer, Request
from tests.exumi_data.builders import (
    CLOCK,
    clip,
    encoded_images,
    jpegs,
    metadata,
    times,
    video_file,
)
from tests.servers import Web, web

NAME = "wéird % #name? %2F+&=;.zarrs"


def frames_of(source: str | Path) -> np.ndarray:
    episode = exumi_data.open(source)
    assert isinstance(episode, exumi_data.Episode)
    return episode["tactile"].frames[:]


@pytest.mark.parametrize("name", ["packed", "folders"])
def test_a_dataset_is_the_same_on_the_web(site: Web, folders: Path, name: str) -> None:
    here, there = exumi_data.open(folders / name), exumi_data.open(f"{site.url}/{name}")
    assert isinstance(here, exumi_data.Dataset)
    assert isinstance(there, exumi_data.Dataset)
    assert there.fingerprint == here.fingerprint
    for mine, theirs in zip(here, there, strict=True):
        np.testing.assert_array_equal(theirs["tactile"].frames[:], mine["tactile"].frames[:])
        theirs.check_complete()
    assert {method for method, _, _ in site.log} <= {"GET", "HEAD"}


def test_only_parts_of_a_packed_episode_are_sent(site: Web, folders: Path) -> None:
    episode = exumi_data.open(f"{site.url}/whole.zarr.zip")
    assert len(site.log) == 1
    _, _, asked = site.log[0]
    assert asked == "bytes=-65536"
    assert isinstance(episode, exumi_data.Episode)


def test_a_folder_on_the_web_cannot_be_listed(site: Web) -> None:
    episode = exumi_data.open(f"{site.url}/whole.zarr")
    assert isinstance(episode, exumi_data.Episode)
    with pytest.raises(UnreachableError, match="cannot list") as caught:
        episode.store.paths()
    assert "exumi pack" in str(caught.value)


def test_user_and_password_are_sent_and_not_told(site: Web) -> None:
    site.user = "me:pass word"
    url = site.url.replace("://", "://me:pass%20word@") + "/packed"
    dataset = exumi_data.open(url)
    assert isinstance(dataset, exumi_data.Dataset)
    assert dataset.path == site.url.replace("://", "://***@") + "/packed"
    assert "word" not in repr(dataset) + dataset[0].path + repr(dataset[0])
    with pytest.raises(UnreachableError, match=r"denied \(401\)") as caught:
        exumi_data.open(f"{site.url}/packed")
    assert "user:password@ in front of the host" in str(caught.value)


def test_a_signed_url_is_used_and_not_told(site: Web, folders: Path) -> None:
    site.query = "X-Signature=SECRET"
    url = f"{site.url}/packed?X-Signature=SECRET"
    dataset = exumi_data.open(url)
    assert isinstance(dataset, exumi_data.Dataset)
    assert dataset.path == f"{site.url}/packed?***"
    assert len(dataset[:2]) == 2
    assert dataset[1]["tactile"].frames[0].shape == (24, 32, 3)
    site.query = "expired"
    reading._readers.clear()
    with pytest.raises(UnreachableError, match=r"denied \(403\)") as caught:
        exumi_data.open(url)
    assert "SECRET" not in str(caught.value)
    assert "has not expired" in str(caught.value)


@pytest.mark.parametrize(
    ("mode", "message"),
    [
        ("no_ranges", "cannot send parts of a file"),
        ("denied", r"access was denied \(403\)"),
        ("down", "answered with status 503"),
        ("slow", "did not answer in time"),
        ("cut_short", "cut short"),
        ("short", r"sent [\d,]+ of [\d,]+ bytes"),
        ("other_range", "Requested"),
        ("much", "sends more than it was asked for"),
        ("compressed", r"compressed \(Content-Encoding: gzip\)"),
        ("circle", "sends on without end"),
        ("hang_up", "cannot be reached|cut short"),
    ],
)
def test_servers_that_do_wrong(site: Web, mode: str, message: str) -> None:
    site.mode = mode
    tracemalloc.start()
    try:
        with pytest.raises(UnreachableError, match=message) as caught:
            exumi_data.open(f"{site.url}/whole.zarr.zip")
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    said = str(caught.value)
    assert said.startswith(f"{site.url}/whole.zarr.zip: ")
    assert "\n" not in said
    assert len(said) < 400
    assert most < 32 << 20


def test_a_server_that_knows_ranges_but_no_ends(site: Web, folders: Path) -> None:
    site.mode = "no_ends"
    np.testing.assert_array_equal(
        frames_of(f"{site.url}/whole.zarr.zip"), frames_of(folders / "whole.zarr.zip")
    )
    site.log.clear()
    packed = exumi_data.open(f"{site.url}/packed")
    assert isinstance(packed, exumi_data.Dataset)
    assert packed[0]["tactile"].frames[0].shape == (24, 32, 3)
    assert [asked for _, _, asked in site.log if (asked or "").startswith("bytes=-")] == []


def test_names_with_every_character(folders: Path, tmp_path: Path) -> None:
    shutil.copytree(folders / "packed", tmp_path / NAME)
    shutil.copytree(folders / "whole.zarr", tmp_path / NAME / "x.zarr")
    with web(tmp_path) as site:
        url = f"{site.url}/{quote(NAME)}"
        dataset = exumi_data.open(url)
        assert isinstance(dataset, exumi_data.Dataset)
        assert dataset[0]["tactile"].frames[:].shape[1:] == (24, 32, 3)
        assert len(frames_of(f"{url}/x.zarr"))


def test_of_a_video_only_what_is_needed_is_sent(
    tmp_path: Path, counted: list[Request], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing for other streams' frames; for one of its own frames not all of it."""
    content, pts, keyframes, base = clip()
    content += (8 << 20).to_bytes(4, "big") + b"free" + bytes((8 << 20) - 8)
    images_of_video: Any = {"encoding": "video", "height": 24, "width": 32, "channels": 3}
    with EpisodeWriter(tmp_path / "a.zarr", metadata(0), durable=False) as writer:
        tactile = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=encoded_images())
        tactile.append(times(), jpegs())
        video = writer.add_stream(
            "gopro", kind="rgb", clock=CLOCK, images=VideoImages(**images_of_video)
        )
        video.append_file(
            content, video_file(content, base), pts=np.array(pts), keyframe=np.array(keyframes)
        )
    pack(tmp_path / "a.zarr")
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "0")
    monkeypatch.setattr(images, "_WHOLE_VIDEO_BYTES", 1 << 20)
    with web(tmp_path) as site:
        episode = exumi_data.open(f"{site.url}/a.zarr.zip")
        assert isinstance(episode, exumi_data.Episode)
        assert len(episode["tactile"].frames[:]) == len(episode["gopro"].time)
        assert sum(request.length for request in counted) < 400_000
        assert episode["gopro"].frames[3].shape == (24, 32, 3)
        assert sum(request.length for request in counted) < 4_000_000


def test_a_server_without_tags(site: Web, folders: Path) -> None:
    site.mode = "no_tag"
    np.testing.assert_array_equal(
        frames_of(f"{site.url}/whole.zarr.zip"), frames_of(folders / "whole.zarr.zip")
    )


def test_nothing_is_kept_of_what_has_no_version(folders: Path, tmp_path: Path) -> None:
    file = tmp_path / "a.zarr.zip"
    file.write_bytes((folders / "whole.zarr.zip").read_bytes())
    cache = Path(os.environ["EXUMI_CACHE"])
    with web(tmp_path) as site:
        site.mode = "no_version"
        url = f"{site.url}/a.zarr.zip"
        frames_of(url)
        assert not list(cache.rglob("*.blocks"))
        opened = RemoteFile(Address.parse(url))
        before = opened.read(0, 4)
        file.write_bytes(b"else" + file.read_bytes()[4:])
        assert opened.read(0, 4) == before
        assert RemoteFile(Address.parse(url)).read(0, 4) == b"else"


def test_what_objects_claim_to_hold_costs_no_memory() -> None:
    address = Address.parse("https://host/a.zarr.zip")
    with pytest.raises(LimitError, match="has 1,152,921,504,606,846,976 bytes, it says"):
        RemoteFile(address, Identity(1 << 60, "one"))
    file = RemoteFile(address, Identity(200 << 30, "one"))
    tracemalloc.start()
    try:
        claimed = [Span(file, at << 30, (at + 9) << 30) for at in range(100)]
        assert reading.bytes_of(claimed) == 256 << 20
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 16 << 20


@pytest.mark.parametrize(
    "host", ["bucket.s3.us-east-1.amazonaws.com", "s3.amazonaws.com", "me.blob.core.windows.net"]
)
def test_a_signed_url_needs_no_credentials(host: str) -> None:
    store = requests._store(f"https://{host}", "X-Amz-Signature=SECRET", "")
    assert isinstance(store, obstore.store.HTTPStore)


def test_ctrl_c_is_heard_while_a_server_is_silent(site: Web) -> None:
    site.mode = "silent"
    program = "import signal, sys, exumi_data; "
    program += "signal.signal(signal.SIGINT, signal.default_int_handler); "
    program += "exumi_data.open(sys.argv[1])"
    process = subprocess.Popen(
        [sys.executable, "-c", program, f"{site.url}/whole.zarr.zip"],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        while not site.log and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=10)
    finally:
        process.kill()
    assert said.rstrip().endswith("KeyboardInterrupt")


def test_after_ctrl_c_a_forked_process_gets_the_answers_to_its_own_questions(
    site: Web, folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetching, "_is_fork", True)
    data = (folders / "whole.zarr.zip").read_bytes()
    address = Address.parse(f"{site.url}/whole.zarr.zip")
    fetcher = fetching.Fetcher()
    (outcome,) = fetcher.fetch([Request("range", address, 0, 10)])
    assert isinstance(outcome, Answer)
    assert outcome.data == data[:10]
    site.mode = "slow"
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with pytest.raises(KeyboardInterrupt):
            fetcher.fetch([Request("range", address, 10, 10)])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    site.mode = ""
    (outcome,) = fetcher.fetch([Request("range", address, 20, 10)])
    assert isinstance(outcome, Answer)
    assert outcome.data == data[20:30]
    assert fetcher._helper is not None
    fetcher._helper.stop()


FORKED = """
import multiprocessing, sys, threading
import obstore
from obstore.store import HTTPStore
{first}
host, url = sys.argv[1:]

def work(answers):
    import exumi_data
    episode = exumi_data.open(url)
    answers.put([episode.id, episode.metadata.licence])

store = HTTPStore.from_url(host, client_options={{"allow_http": True}})
obstore.get(store, "whole.zarr.zip").bytes()
context = multiprocessing.get_context("fork")
answers = context.Queue()
process = context.Process(target=work, args=(answers,), daemon=True)
process.start()
print(answers.get(timeout=20)[0])
"""


@pytest.mark.parametrize("first", ["", "import exumi_data.store.remote.fetching"])
def test_a_fork_of_a_program_that_used_obstore_itself(
    site: Web, folders: Path, first: str, tmp_path: Path
) -> None:
    """Its calls would wait for ever, and crash the program that was forked."""
    program, data = tmp_path / "program.py", tmp_path / "data"
    program.write_text(FORKED.format(first=first))
    data.mkdir()
    # Where the program runs, a file may have any name: it is nobody's module.
    (data / "obstore.py").write_text("raise SystemExit('data was run')")
    done = subprocess.run(
        [sys.executable, program, site.url, f"{site.url}/whole.zarr.zip"],
        cwd=data,
        check=False,
        capture_output=True,
        text=True,
        timeout=50,
    )
    here = exumi_data.open(folders / "whole.zarr.zip")
    assert isinstance(here, exumi_data.Episode)
    assert (done.stdout.strip(), done.returncode) == (here.id, 0), done.stderr


def test_a_file_that_changes(site: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "0")
    episode = exumi_data.open(f"{site.url}/whole.zarr.zip")
    assert isinstance(episode, exumi_data.Episode)
    site.tags["/whole.zarr.zip"] = "two"
    large = max(episode.store.paths(), key=episode.store.size)
    reading._readers.clear()
    with pytest.raises(ChangedDataError, match="changed after it was opened"):
        episode.store.read_range(large, 0, 100)


def test_a_download_is_whole_or_not_there(site: Web, folders: Path, tmp_path: Path) -> None:
    target = download(f"{site.url}/whole.zarr.zip", tmp_path / "got.zip")
    assert target.read_bytes() == (folders / "whole.zarr.zip").read_bytes()
    with pytest.raises(NotAnEpisodeError):
        download(f"{site.url}/nothing.zip", tmp_path / "none.zip")
    site.mode = "cut_short"
    with pytest.raises(UnreachableError):
        download(f"{site.url}/whole.zarr.zip", tmp_path / "half.zip")
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["got.zip"]


def test_a_helper_whose_program_was_killed_ends_in_silence(site: Web) -> None:
    helper = subprocess.Popen(
        [sys.executable, "-m", "exumi_data.store.remote.helper"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    with helper:
        assert helper.stdin
        assert helper.stdout
        assert helper.stderr
        helper.stdout.close()
        helper.stdin.write(
            json.dumps([["head", site.url, "whole.zarr.zip", "", "", 0, 0]]).encode()
        )
        helper.stdin.close()
        assert (helper.stderr.read(), helper.wait(60)) == (b"", 0)


def test_a_host_of_credentials_is_a_host_like_others_on_the_web() -> None:
    error = requests._explained(
        OSError("http://metadata.google.internal/ kind: Connect"), Address.parse("https://a.b/c")
    )
    assert error.what == "the server cannot be reached"


def test_whoever_sees_which_object_it_is_knows_its_key() -> None:
    seen = []

    class Noting(RemoteFile):
        __slots__ = ()

        def __setattr__(self, name: str, value: object) -> None:
            if name == "_identity" and value is not None:
                seen.append(self.key)
            super().__setattr__(name, value)

    file = Noting(Address.parse("https://a.b/c"), Identity(7, "one"))
    assert seen == [file.key]
    assert seen != [""]
