"""Folders and zips from strangers: safe paths, no links, no tricks; and nothing is written."""

import errno
import os
import shutil
import stat
import struct
import threading
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from exumi_data.episode import open_episode
from exumi_data.errors import (
    ChangedDataError,
    DamagedDataError,
    ExumiError,
    LimitError,
    NotAnEpisodeError,
)
from exumi_data.store import access
from exumi_data.store.access import FolderStore, OpenFiles, ZipStore, open_store
from exumi_data.store.pack import pack
from exumi_data.store.paths import check_member_path
from tests.exumi_data.builders import copy_of, jpegs, write_small

BAD_PATHS = [
    "",
    "/etc/passwd",
    "../a",
    "a/../b",
    "a/..",
    "..",
    ".",
    "a/./b",
    "a//b",
    "a/",
    "C:/a",
    "c:a",
    "a\\b",
    "..\\a",
    "a\0b",
    "x" * 2000,
    "a\udc80",
]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small(tmp_path_factory.mktemp("original") / "a.zarr")


@pytest.fixture
def episode(original: Path, tmp_path: Path) -> Path:
    return copy_of(original, tmp_path / "a.zarr")


@pytest.mark.parametrize("path", BAD_PATHS)
def test_unsafe_paths_are_refused(path: str, episode: Path) -> None:
    with pytest.raises(DamagedDataError, match="unsafe path"):
        check_member_path(path, "here")
    for store in (FolderStore(episode), ZipStore(pack(episode))):
        for read in (store.read, store.size, lambda p, s=store: s.read_range(p, 0, 1)):
            with pytest.raises((DamagedDataError, FileNotFoundError)):
                read(path)


@pytest.mark.parametrize("path", ["a", "a/b.c", "zarr.json", ".zattrs", "a b/ä", "...", "c/0/0"])
def test_safe_paths_are_taken(path: str) -> None:
    assert check_member_path(path, "here") == path


def test_folder_and_zip_hold_the_same(episode: Path) -> None:
    folder, packed = open_store(episode), open_store(pack(episode))
    assert isinstance(folder, FolderStore)
    assert isinstance(packed, ZipStore)
    assert folder.paths() == packed.paths()
    for path in folder.paths():
        content = folder.read(path)
        assert content == packed.read(path) == (episode / path).read_bytes()
        assert folder.size(path) == packed.size(path) == len(content)
        for start, length in ((0, 0), (1, 3), (0, len(content)), (len(content), 0)):
            expected = content[start : start + length]
            assert folder.read_range(path, start, length) == expected
            assert packed.read_range(path, start, length) == expected
        for store in (folder, packed):
            with pytest.raises(DamagedDataError):
                store.read_range(path, 1, len(content))
    for store in (folder, packed):
        for missing in ("no", "streams/no", "zarr.json/no", "streams"):
            for read in (store.read, store.size, lambda p, s=store: s.read_range(p, 0, 1)):
                with pytest.raises(FileNotFoundError):
                    read(missing)


def test_a_closed_store_opens_its_files_again(episode: Path) -> None:
    for store in (FolderStore(episode), ZipStore(pack(episode))):
        before = store.read_range("zarr.json", 0, 10)
        store.close()
        assert store.read_range("zarr.json", 0, 10) == before


def open_descriptors() -> int:
    folder = Path("/proc/self/fd")
    if not folder.is_dir():
        pytest.skip("this system does not list the open files of a process")
    return len(list(folder.iterdir()))


def test_few_files_stay_open(episode: Path) -> None:
    files = OpenFiles(3)
    store = FolderStore(episode, files)
    before = open_descriptors()
    for _ in range(3):
        for path in store.paths():
            store.read_range(path, 0, 1)
            store.read(path)
    assert open_descriptors() <= before + 3
    store.close()
    assert open_descriptors() <= before


def test_of_many_stores_few_files_stay_open(episode: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access, "_MOST_OWN", 12)
    packed = pack(episode)
    before = open_descriptors()
    stores = [FolderStore(episode) for _ in range(10)] + [ZipStore(packed) for _ in range(10)]
    for _ in range(2):
        for store in stores:
            for path in store.paths():
                assert len(store.read_range(path, 0, 1)) == 1
        assert open_descriptors() <= before + 12
    del store, stores
    assert open_descriptors() <= before


def test_too_many_open_files_are_not_called_damage(
    episode: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other, store = FolderStore(episode), FolderStore(episode)
    other.read_range("zarr.json", 0, 1)
    real = os.open
    left = 1

    def scarce(path: str, flags: int) -> int:
        nonlocal left
        if len(other._files._files) or not left:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), path)
        return real(path, flags)

    monkeypatch.setattr("exumi_data.store.access.os.open", scarce)
    assert len(store.read("zarr.json")) > 1  # by what the other one held open
    left = 0
    with pytest.raises(LimitError, match="too many files are open"):
        store.read("zarr.json")


def test_threads_share_a_store(episode: Path) -> None:
    store = FolderStore(episode, OpenFiles(2))
    wanted = {path: store.read(path) for path in store.paths()}
    wrong: list[str] = []

    def read(seed: int) -> None:
        generator = np.random.default_rng(seed)
        paths = list(wanted)
        for index in generator.integers(0, len(paths), 300):
            path = paths[int(index)]
            if store.read_range(path, 0, len(wanted[path])) != wanted[path]:
                wrong.append(path)

    threads = [threading.Thread(target=read, args=(seed,)) for seed in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def snapshot(root: Path) -> dict[str, tuple[int, int, int]]:
    return {
        str(path.relative_to(root)): (info.st_mtime_ns, info.st_size, info.st_mode)
        for path in [root, *root.rglob("*")]
        for info in [path.lstat()]
    }


def test_reading_never_writes(episode: Path) -> None:
    pack(episode)
    root = episode.parent
    for path in root.rglob("*"):
        path.chmod(stat.S_IRUSR | stat.S_IRGRP | (stat.S_IXUSR if path.is_dir() else 0))
    before = snapshot(root)
    for path in (episode, episode.with_name("a.zarr.zip")):
        with open_episode(path) as opened:
            opened.check_complete()
            opened.digest()
            assert opened["tactile"].frames[:].shape == (5, 24, 32, 3)
            assert opened["tactile"].activity is not None
    assert snapshot(root) == before
    for path in [root, *root.rglob("*")]:
        path.chmod(0o755)


# -------------------------------------------------------------------------------------------- links


def test_links_inside_a_folder_are_not_followed(episode: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    shutil.copytree(episode / "streams" / "width", secret)
    shutil.rmtree(episode / "streams" / "width")
    (episode / "streams" / "width").symlink_to(secret)
    opened = open_episode(episode)
    for read in (
        lambda: opened["width"].time,
        opened.digest,
        opened.check_complete,
        lambda: pack(episode),
    ):
        with pytest.raises(DamagedDataError, match="width is a link; links are not followed"):
            read()
    assert not episode.with_name("a.zarr.zip").exists()


@pytest.mark.parametrize("name", ["zarr.json", "streams/tactile/data/c/0", "derived/zarr.json"])
def test_linked_files_are_not_followed(episode: Path, tmp_path: Path, name: str) -> None:
    (episode / name).rename(tmp_path / "secret")
    (episode / name).symlink_to(tmp_path / "secret")

    def read_all() -> None:
        opened = open_episode(episode)
        _ = opened["tactile"].frames[:], opened.derived

    with pytest.raises(DamagedDataError, match=f"{name} is a link"):
        read_all()


def test_an_episode_may_itself_be_reached_through_a_link(episode: Path, tmp_path: Path) -> None:
    for number, path in enumerate((episode, pack(episode))):
        link = tmp_path / f"link{number}{path.suffix}"
        link.symlink_to(path)
        opened = open_episode(link)
        assert opened["tactile"].encoded(1) == jpegs()[1]


def test_a_pipe_does_not_make_a_reader_wait(episode: Path) -> None:
    (episode / "zarr.json").unlink()
    os.mkfifo(episode / "zarr.json")
    with pytest.raises(NotAnEpisodeError):
        open_episode(episode)
    os.mkfifo(episode / "pipe")
    with pytest.raises(DamagedDataError, match="neither a file nor a folder"):
        FolderStore(episode).paths()


def test_a_name_that_is_not_utf8_is_refused(episode: Path) -> None:
    try:
        (episode / os.fsdecode(b"caf\xe9")).write_bytes(b"")
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    with pytest.raises(DamagedDataError, match="unsafe path"):
        FolderStore(episode).paths()
    with pytest.raises(DamagedDataError, match="unsafe path"):
        pack(episode)


def test_a_metadata_file_is_bounded(episode: Path) -> None:
    os.truncate(episode / "zarr.json", 100 << 30)  # sparse: it takes no room
    with pytest.raises(LimitError, match=r"a metadata file of 107,374,182,400 bytes"):
        open_episode(episode)


# --------------------------------------------------------------------------------------------- zips


def rebuilt(source: Path, change: Callable[[str, zipfile.ZipInfo], zipfile.ZipInfo | None]) -> Path:
    """Copy a packed episode, member by member, changed."""
    target = source.with_name("changed.zarr.zip")
    with (
        zipfile.ZipFile(source) as old,
        zipfile.ZipFile(target, "w") as new,
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # zipfile warns of duplicate names
        for info in old.infolist():
            wanted = change(info.filename, zipfile.ZipInfo(info.filename))
            if wanted is not None:
                new.writestr(wanted, old.read(info))
    return target


def renamed(name: str) -> Callable[[str, zipfile.ZipInfo], zipfile.ZipInfo]:
    def change(path: str, info: zipfile.ZipInfo) -> zipfile.ZipInfo:
        if path == "streams/width/zarr.json":
            info.filename = info.orig_filename = name
        return info

    return change


def compressed(_: str, info: zipfile.ZipInfo) -> zipfile.ZipInfo:
    info.compress_type = zipfile.ZIP_DEFLATED
    return info


def linked(path: str, info: zipfile.ZipInfo) -> zipfile.ZipInfo:
    if path.endswith("width/zarr.json"):
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (renamed("../evil"), r"unsafe path '../evil'"),
        (renamed("/evil"), "unsafe path"),
        (renamed("a\\b"), "unsafe path"),
        (renamed("C:evil"), "unsafe path"),
        (renamed("zarr.json"), "appears twice"),
        (renamed("streams/"), "is a directory entry"),
        (compressed, "is compressed"),
        (linked, "is a link"),
    ],
)
def test_a_zip_with_a_trick_is_refused(
    episode: Path, change: Callable[..., zipfile.ZipInfo], message: str
) -> None:
    with pytest.raises(DamagedDataError, match=message):
        open_episode(rebuilt(pack(episode), change))


def central(content: bytes, name: bytes) -> int:
    """Where a member's entry of the central directory begins."""
    position = content.index(b"PK\x01\x02")
    while content[position + 46 :][: len(name)] != name:
        position = content.index(b"PK\x01\x02", position + 1)
    return position


def patched(path: Path, offset: int, form: str, value: int, name: bytes = b"zarr.json") -> Path:
    """Change a field of a member's entry in the central directory."""
    content = bytearray(path.read_bytes())
    struct.pack_into(form, content, central(bytes(content), name) + offset, value)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("offset", "form", "value", "message"),
    [
        (8, "<H", 0x1, "is encrypted"),
        (8, "<H", 0x8, "has a data descriptor"),
        (10, "<H", 8, "is compressed"),
        (10, "<H", 99, "is compressed"),
        (20, "<I", 7, "two different sizes"),
        (24, "<I", 0x7FFFFFFF, "two different sizes"),
        (42, "<I", 0x7FFFFFFF, "beyond the end"),
        (42, "<I", 3, "no valid local header"),
        (6, "<H", 0xFF, "not a readable zip"),
        (28, "<H", 0xFFFF, "not a readable zip|unsafe path"),
        (30, "<H", 0xFFFF, "not a readable zip"),
    ],
)
def test_a_directory_that_lies_is_refused(
    episode: Path, offset: int, form: str, value: int, message: str
) -> None:
    packed = patched(pack(episode), offset, form, value)
    with pytest.raises(DamagedDataError, match=message):
        open_episode(packed)


def test_both_sizes_beyond_the_end(episode: Path) -> None:
    packed = pack(episode)
    patched(packed, 20, "<I", 0x7FFFFFFF)
    patched(packed, 24, "<I", 0x7FFFFFFF)
    with pytest.raises(DamagedDataError, match="beyond the end"):
        open_episode(packed)


@pytest.mark.parametrize(
    ("offset", "value"), [(0, 0x51), (6, 1), (6, 8), (8, 8), (26, 200), (28, 0xFF), (30, ord("x"))]
)
def test_a_local_header_that_disagrees_is_refused(episode: Path, offset: int, value: int) -> None:
    packed = pack(episode)
    content = bytearray(packed.read_bytes())
    content[offset] = value
    packed.write_bytes(content)
    with pytest.raises(ExumiError):
        open_episode(packed)


def test_a_zip_cut_short_anywhere_is_refused(episode: Path) -> None:
    packed = pack(episode)
    whole = packed.read_bytes()
    for length in [0, 1, 3, 4, 30, *range(100, len(whole), 997), len(whole) - 1]:
        packed.write_bytes(whole[:length])
        with pytest.raises((DamagedDataError, NotAnEpisodeError)):
            open_episode(packed)


def test_what_is_no_zip_is_no_episode(tmp_path: Path) -> None:
    for name, content in (("a.txt", b"hello"), ("a.zarr.zip", b""), ("b.zarr", b"PK\x05\x06")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(NotAnEpisodeError, match=name):
            open_episode(tmp_path / name)


def test_extra_fields_and_distant_members_are_read(episode: Path) -> None:
    """Zip64: another program may write longer headers; large datasets have offsets above 4 GiB."""
    source = pack(episode)
    target = episode.with_name("far.zarr.zip")
    with zipfile.ZipFile(source) as old, target.open("wb") as file:
        file.write(b"PK\x03\x04")
        file.seek(5 << 30)  # sparse: it takes no room
        with zipfile.ZipFile(file, "w") as new:
            for info in old.infolist():
                with new.open(zipfile.ZipInfo(info.filename), "w", force_zip64=True) as member:
                    member.write(old.read(info))
    with zipfile.ZipFile(target) as archive:
        assert min(info.header_offset for info in archive.infolist()) == 5 << 30
    near, far = open_episode(source), open_episode(target)
    assert far.digest() == near.digest()
    np.testing.assert_array_equal(far["tactile"].frames[:], near["tactile"].frames[:])


SHARD = "streams/tactile/data/c/0"


@pytest.mark.parametrize("packed", [False, True])
def test_a_file_that_took_the_name_of_another_is_not_read(episode: Path, packed: bool) -> None:
    path = pack(episode) if packed else episode
    inside = SHARD
    file = path if packed else path / inside
    files = OpenFiles()
    store = open_store(path, files)
    before = store.read_range(inside, 0, 16)
    other = file.with_name("other")
    other.write_bytes(file.read_bytes())
    other.rename(file)
    assert store.read_range(inside, 0, 16) == before  # still open: what was there
    files.clear()
    with pytest.raises(ChangedDataError, match="changed after"):
        store.read_range(inside, 0, 16)
    assert open_store(path).read_range(inside, 0, 16) == before
    if not packed:
        file.unlink()
        files.clear()
        with pytest.raises(ChangedDataError, match="changed after"):
            store.read_range(inside, 0, 16)


def test_files_of_an_episode_that_took_the_place_of_another(episode: Path, original: Path) -> None:
    store = FolderStore(episode)
    store.read("zarr.json")
    other = copy_of(original, episode.with_name("other"))
    episode.rename(episode.with_name("aside"))  # as a writer does
    other.rename(episode)
    with pytest.raises(ChangedDataError, match="changed after"):
        store.read_range(SHARD, 0, 16)
