"""Loaders give the same from a server as from the disk, with few requests, in any worker."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import exumi_data
from exumi_data.episode import open_episode
from exumi_data.errors import ChangedDataError, UnreachableError
from exumi_data.store.remote import reading, requests
from exumi_loaders import Clips, ConcatWindows, PolicyWindows, TPPWindows
from tests.exumi_loaders.conftest import Recipe, write_dataset
from tests.servers import S3, S3_ENVIRONMENT, Web, pack_dataset, web

# Python 3.12 and later warn of forks of processes with threads, which is provided for.
pytestmark = pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")

OPTIONS: dict[str, Any] = {"cache": False, "image_tolerance_s": 0.1}


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Nothing is known, and failures are given up soon."""
    monkeypatch.setenv("EXUMI_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(requests, "_RETRIES", 0)
    reading._readers.clear()
    requests._store.cache_clear()
    yield
    reading._readers.clear()
    requests._store.cache_clear()


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four episodes in colour, with frames as JPEG files and as arrays; packed, and not."""
    root = tmp_path_factory.mktemp("remote")
    seconds = list(np.arange(60) / 20)
    common: dict[str, Any] = {"rgb_s": seconds, "pose_s": seconds, "width_s": seconds}
    recipes = [
        Recipe(
            tactile_s=seconds,
            activity=seconds,
            encoded=number % 2 == 0,
            channels=3,
            side=32,
            **common,
        )
        for number in range(4)
    ]
    write_dataset(root / "set", recipes)
    pack_dataset(root / "set", root / "packed")
    return root


@pytest.fixture
def site(places: Path) -> Iterator[Web]:
    with web(places) as server:
        yield server


def dataset(source: str | Path) -> exumi_data.Dataset:
    found = exumi_data.open(source)
    assert isinstance(found, exumi_data.Dataset)
    return found


def assert_same(mine: Any, theirs: Any) -> None:
    assert list(mine) == list(theirs)
    for name, value in mine.items():
        # The last bit of a product of matrices depends on how many are multiplied at once.
        torch.testing.assert_close(theirs[name], value, rtol=0, atol=1e-7, msg=name)


@pytest.mark.parametrize(("name", "episodes"), [("packed", 4), ("set", 1)])
def test_windows_are_the_same(site: Web, places: Path, name: str, episodes: int) -> None:
    here, there = (
        TPPWindows(dataset(place)[:episodes], proprioception=True, **OPTIONS)
        for place in (places / name, f"{site.url}/{name}")
    )
    chosen = [number % len(here) for number in (3, 70, 71, 5, 130, 200, 3)]
    assert_same(here.__getitems__(chosen), there.__getitems__(chosen))
    mine, theirs = (
        PolicyWindows(windows.episodes, cache=False).__getitems__(chosen)
        for windows in (here, there)
    )
    assert_same(mine, theirs)
    both = ConcatWindows([there, there]).__getitems__([3, len(there) + 3])
    assert torch.equal(both["tactile"][0], both["tactile"][1])


def test_files_stay_files(site: Web, places: Path) -> None:
    here, there = (
        TPPWindows(dataset(place).select([dataset(place).ids[0]]), decode="device", **OPTIONS)
        for place in (places / "packed", f"{site.url}/packed")
    )
    mine, theirs = here.__getitems__([3, 9]), there.__getitems__([3, 9])
    for name in ("tactile", "rgb"):
        assert type(mine[name]) is type(theirs[name])
        assert repr(mine[name]) == repr(theirs[name])


def test_a_batch_takes_few_requests(site: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "0")
    windows = TPPWindows(dataset(f"{site.url}/packed"), **OPTIONS)
    assert len(site.log) <= 2 + 3 * 4
    reading._readers.clear()
    windows.__getitems__(list(range(0, len(windows), 4)))
    site.log.clear()
    reading._readers.clear()  # what says where frames are stays in the readers
    windows.__getitems__(list(range(0, len(windows), 4)))
    assert len(site.log) <= 2 * 4


def first_batches(windows: TPPWindows, **options: Any) -> list[Any]:
    loader = windows.loader(16, shuffle=True, num_workers=2, **options)
    return [batch for batch, _ in zip(loader, range(3), strict=False)]


def test_forked_workers_read_for_themselves(site: Web, places: Path) -> None:
    # This process has asked the server for the timeline: obstore's threads run here, and not there.
    there = TPPWindows(dataset(f"{site.url}/packed"), **OPTIONS)
    here = TPPWindows(dataset(places / "packed"), **OPTIONS)
    for mine, theirs in zip(first_batches(here), first_batches(there), strict=True):
        assert_same(mine, theirs)


def test_fresh_workers_read_for_themselves(site: Web, places: Path) -> None:
    there = TPPWindows(dataset(f"{site.url}/packed"), **OPTIONS)
    here = TPPWindows(dataset(places / "packed"), **OPTIONS)
    theirs = first_batches(there, multiprocessing_context="forkserver")
    for mine, its in zip(first_batches(here), theirs, strict=True):
        assert_same(mine, its)


def test_windows_of_a_bucket(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = S3()
    try:
        url = server.upload(places / "packed", "packed")
        for name, value in {**S3_ENVIRONMENT, "AWS_ENDPOINT_URL": server.endpoint}.items():
            monkeypatch.setenv(name, value)
        there = TPPWindows(dataset(url), **OPTIONS)
        here = TPPWindows(dataset(places / "packed"), **OPTIONS)
        for mine, theirs in zip(first_batches(here), first_batches(there), strict=True):
            assert_same(mine, theirs)
    finally:
        server.stop()


def test_the_second_opening_reads_no_episode(site: Web) -> None:
    first = TPPWindows(dataset(f"{site.url}/packed"))
    site.log.clear()
    second = TPPWindows(dataset(f"{site.url}/packed"))
    assert len(site.log) == 2
    assert_same(first.__getitems__([3, 90]), second.__getitems__([3, 90]))


def test_small_memory_gives_the_same(
    site: Web, places: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "0")
    monkeypatch.setattr(reading, "_MEMORY", (96 << 10, 96 << 10))
    there = TPPWindows(dataset(f"{site.url}/packed"), **OPTIONS)
    here = TPPWindows(dataset(places / "packed"), **OPTIONS)
    chosen = list(range(0, len(here), 3))
    assert_same(here.__getitems__(chosen), there.__getitems__(chosen))


@pytest.mark.parametrize("on_corrupt", ["raise", "skip", "substitute"])
def test_an_episode_that_changes_stops_training(site: Web, on_corrupt: Any) -> None:
    windows = TPPWindows(dataset(f"{site.url}/packed"), on_corrupt=on_corrupt, **OPTIONS)
    site.tags = {f"/{path.relative_to(site.folder)}": "two" for path in site.folder.rglob("*.zip")}
    reading._readers.clear()
    with pytest.raises(ChangedDataError, match="changed after it was opened"):
        windows.__getitems__([3, 90])


@pytest.mark.parametrize("on_corrupt", ["skip", "substitute"])
def test_a_server_that_fails_is_no_damage(
    site: Web, on_corrupt: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "0")
    windows = TPPWindows(dataset(f"{site.url}/packed"), on_corrupt=on_corrupt, **OPTIONS)
    site.mode = "denied"
    reading._readers.clear()
    with pytest.raises(UnreachableError, match=r"denied \(403\)"):
        windows.__getitems__([3, 90])


_TOUCH = "streams/tactile/data/c/0"  # frames end to end


def test_damage_is_damage_on_a_server_too(places: Path, tmp_path: Path) -> None:
    shutil.copytree(places / "packed", tmp_path / "spoiled")
    found = sorted(tmp_path.glob("spoiled/episodes/*/*.zip"))
    opened = next(one for one in map(open_episode, found) if _TOUCH in one.store.paths())
    path = Path(opened.store.location)
    start, size = opened.store._locate(_TOUCH)  # type: ignore[attr-defined]  # of a zip
    raw = bytearray(path.read_bytes())
    raw[start + size // 2] ^= 255
    path.write_bytes(raw)
    with web(tmp_path) as site:
        here, there = (
            TPPWindows(dataset(place), on_corrupt="substitute", **OPTIONS)
            for place in (tmp_path / "spoiled", f"{site.url}/spoiled")
        )
        chosen = list(range(0, len(here), 5))
        mine, theirs = here.__getitems__(chosen), there.__getitems__(chosen)
    assert mine["substituted"].any()
    assert_same(mine, theirs)


def test_clips_are_the_same(make_touches: Any, touch: Any, tmp_path: Path) -> None:
    make_touches(*(touch(f"part{n}", stored=2, streams=("tactile", "left")) for n in range(3)))
    pack_dataset(tmp_path / "touches", tmp_path / "packed")
    with web(tmp_path) as site:
        here = Clips(dataset(tmp_path / "packed"), frames=2)
        there = Clips(dataset(f"{site.url}/packed"), frames=2)
        assert [clip.id for clip in there.table] == [clip.id for clip in here.table]
        chosen = np.arange(len(here))
        which = np.tile(np.arange(2), (len(here), 1))
        outs = []
        for clips in (here, there):
            out = np.empty((len(here), 2, *here.table[0].shape), np.uint8)
            reference = np.empty((len(here), *here.table[0].shape), np.uint8)
            outcome = clips.read_batch(chosen, which, out, reference)
            assert outcome.there.all()
            outs.append((out, reference))
        np.testing.assert_array_equal(outs[0][0], outs[1][0])
        np.testing.assert_array_equal(outs[0][1], outs[1][1])
