"""A dataset's own files: nothing is followed, nothing waited for, nothing read without end."""

import os
from pathlib import Path

import pytest

from exumi_data.errors import DamagedDataError, LimitError
from exumi_data.store.plain_files import is_plain_file, open_plain, read_plain


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"hello")
    assert read_plain(path, 5) == b"hello"
    assert is_plain_file(path)
    with open_plain(path) as file:
        assert file.read(2) == b"he"
    with pytest.raises(LimitError, match="more than 4 bytes"):
        read_plain(path, 4)


def test_a_sparse_file_of_100_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.touch()
    os.truncate(path, 100 << 30)
    with pytest.raises(LimitError):
        read_plain(path, 1 << 20)


@pytest.mark.parametrize("name", ["gone", "gone/a", "file/a"])
def test_what_is_not_there(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    assert not is_plain_file(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        open_plain(tmp_path / name)


def test_links_pipes_devices_and_folders(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    odd = [tmp_path / name for name in ("link", "loop", "pipe", "folder")] + [Path("/dev/zero")]
    for path in odd:
        assert not is_plain_file(path)
        with pytest.raises(DamagedDataError, match=r"is a link|is no file") as caught:
            read_plain(path, 10)
        assert caught.value.where == str(path)
