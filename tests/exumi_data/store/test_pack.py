"""Packing changes nothing but the wrapping; digests do not see the wrapping."""

import hashlib
import os
import shutil
import stat
import zipfile
from pathlib import Path

import numpy as np
import pytest

from exumi_data.episode import open_episode
from exumi_data.errors import EpisodeExistsError, UsageError
from exumi_data.store import pack as packing
from exumi_data.store.access import open_store
from exumi_data.store.digest import digest_of
from exumi_data.store.pack import pack, packing_order
from tests.exumi_data.builders import copy_of, write_episode


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_episode(tmp_path_factory.mktemp("original") / "a.zarr")


@pytest.fixture
def episode(original: Path, tmp_path: Path) -> Path:
    return copy_of(original, tmp_path / "a.zarr")


def digest(path: Path) -> str:
    return digest_of(open_store(path))


def test_the_digest_is_what_the_standard_says(episode: Path) -> None:
    lines = []
    for path in episode.rglob("*"):
        name = path.relative_to(episode).as_posix()
        if path.is_file() and not name.startswith("derived/"):
            content = path.read_bytes()
            lines.append((name.encode(), hashlib.sha256(content).hexdigest(), len(content)))
    text = "".join(f"{sha} {size} {name.decode()}\n" for name, sha, size in sorted(lines))
    assert digest(episode) == hashlib.sha256(text.encode()).hexdigest()
    assert digest(episode) == digest(pack(episode)) == open_episode(episode).digest()


def test_large_files_are_digested_in_pieces(episode: Path) -> None:
    content = np.random.default_rng(0).bytes((9 << 20) + 17)
    (episode / "streams" / "big").write_bytes(content)
    whole = hashlib.sha256(content).hexdigest()
    from exumi_data.store.digest import sha256_file, sha256_store_file

    assert sha256_file(episode / "streams" / "big") == whole
    store = open_store(episode)
    assert sha256_store_file(store, "streams/big") == (whole, len(content))
    assert digest(episode) == digest(pack(episode))


def test_derived_plays_no_part(episode: Path) -> None:
    before = digest(episode)
    (episode / "derived" / "more").write_bytes(b"x")
    assert digest(episode) == before
    shutil.rmtree(episode / "derived")
    assert digest(episode) == before
    assert digest(pack(episode)) == before


def test_any_change_outside_derived_changes_it(episode: Path) -> None:
    before = {digest(episode)}
    files = sorted(p for p in episode.rglob("*") if p.is_file() and "derived" not in p.parts)
    generator = np.random.default_rng(0)
    for number in generator.choice(len(files), 12, replace=False):
        path = files[number]
        content = bytearray(path.read_bytes())
        content[generator.integers(len(content))] ^= 1 << int(generator.integers(8))
        path.write_bytes(content)
        before.add(digest(episode))
    (episode / "new").write_bytes(b"")
    before.add(digest(episode))
    (episode / "new").rename(episode / "renamed")
    before.add(digest(episode))
    (episode / "renamed").unlink()
    before.add(digest(episode))
    assert len(before) == 1 + 12 + 2


def test_two_packs_are_equal_to_the_byte(original: Path, tmp_path: Path) -> None:
    first = pack(original, tmp_path / "1.zarr.zip")
    other = copy_of(original, tmp_path / "other.zarr")
    for path in other.rglob("*"):
        os.utime(path, (1, 1))
        path.chmod(0o700)
    assert pack(other, tmp_path / "2.zarr.zip").read_bytes() == first.read_bytes()


def test_how_members_are_stored(episode: Path) -> None:
    packed = pack(episode)
    with zipfile.ZipFile(packed) as archive:
        infos = archive.infolist()
        assert archive.testzip() is None
    names = [info.filename for info in infos]
    assert sorted(names) == open_store(episode).paths()
    documents = [name for name in names if name.endswith("zarr.json")]
    assert names[: len(documents)] == documents  # metadata first, the root's first of all
    assert names[0] == "zarr.json"
    depths = [name.count("/") for name in documents]
    assert depths == sorted(depths)
    for info in infos:
        assert info.compress_type == zipfile.ZIP_STORED
        assert info.flag_bits == 0  # not encrypted, no data descriptor, names are ASCII
        assert (info.create_system, info.create_version, info.extract_version) == (3, 20, 20)
        assert info.date_time == (1980, 1, 1, 0, 0, 0)
        assert info.external_attr >> 16 == stat.S_IFREG | 0o644
        assert info.extra == b""
        assert not info.is_dir()


def test_the_order_does_not_depend_on_the_file_system() -> None:
    expected = [
        "zarr.json",
        "a/zarr.json",
        "b/zarr.json",
        "a/c/zarr.json",
        "a/c/0",
        "a/zarr.jsonx",
        "b/x",
    ]
    for seed in range(5):
        shuffled = np.random.default_rng(seed).permutation(expected).tolist()
        assert packing_order(shuffled) == expected


def test_large_members_get_long_headers(episode: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A member of 2 GiB cannot be written in a test; that all are treated as such can.
    plain = digest(pack(episode))
    monkeypatch.setattr(packing, "_ZIP64_FROM", 0)
    packed = pack(episode, episode.with_name("long.zarr.zip"))
    with zipfile.ZipFile(packed) as archive:
        assert archive.infolist()[1].header_offset > len("zarr.json") + 30 + 20
        assert archive.testzip() is None
    assert digest(packed) == plain
    assert open_episode(packed)["tactile"].frames[1].shape == (24, 32, 3)


def test_what_is_not_packed(episode: Path, tmp_path: Path) -> None:
    packed = pack(episode)
    before = packed.read_bytes()
    with pytest.raises(EpisodeExistsError, match=r"a\.zarr\.zip: already exists"):
        pack(episode)
    with pytest.raises(UsageError, match="in its own folder"):
        pack(episode, episode / "streams" / "a.zarr.zip")
    (tmp_path / "empty.zarr").mkdir()
    for nothing in (tmp_path / "empty.zarr", tmp_path / "missing.zarr", packed):
        with pytest.raises(UsageError, match="not a finished episode"):
            pack(nothing)
    (episode / "streams" / "link").symlink_to(tmp_path)
    with pytest.raises(Exception, match="is a link"):
        pack(episode, overwrite=True)
    assert packed.read_bytes() == before
    (episode / "streams" / "link").unlink()
    (episode / "more").write_bytes(b"x")
    assert pack(episode, overwrite=True).read_bytes() != before
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.zarr",
        "a.zarr.zip",
        "empty.zarr",
    ]
