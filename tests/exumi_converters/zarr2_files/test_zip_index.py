"""The directory of a zip is read as zipfile reads it, and nothing in it is trusted."""

import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from exumi_converters.umi.sinks import ZipSink
from exumi_converters.zarr2_files import zip_index
from exumi_converters.zarr2_files.zip_index import Member, is_zip, read_index, read_member
from exumi_data.errors import ExumiError, LimitError, SourceError


def write_zip(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def content_of(path: Path, record: np.void) -> bytes:
    with path.open("rb") as file:
        return read_member(file.fileno(), Member._make(record.tolist()), path)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_members_are_found_by_array_and_chunk(tmp_path: Path, method: int) -> None:
    chunks = {
        f"data/a/{row}.0.0.{piece}": b"%d" % (10 * row + piece) * 99
        for row in (2, 0, 10)
        for piece in (0, 1)
    }
    path = write_zip(tmp_path / "a.zip", {**chunks, "data/a/.zarray": b"{}", "x/": b""}, method)
    index = read_index(path)
    assert list(index.documents) == ["data/a/.zarray"]
    table = index.chunks["data/a", "0.0.1"]
    assert table["row"].tolist() == [0, 2, 10]
    assert content_of(path, table[1]) == b"21" * 99


def test_chunks_in_folders_are_the_same(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"data/a/7/0/1": b"x", "data/b/3": b"y"})
    assert set(read_index(path).chunks) == {("data/a", "0.1"), ("data/b", "")}


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_of_two_members_of_one_name_the_last_counts(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for content in (b"first", b"second"):
            archive.writestr("data/a/0.0", content)
    (record,) = read_index(path).chunks["data/a", "0"]
    assert content_of(path, record) == b"second"


def test_a_sink_writes_what_zipfile_reads(tmp_path: Path) -> None:
    members = {".zgroup": b"{}", **{f"data/a/{i}.0": b"%d" % i * i for i in range(300)}}
    with ZipSink(tmp_path / "a.zip") as sink:
        for name, content in members.items():
            sink.put(name, content)
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.testzip() is None
        assert {n: archive.read(n) for n in archive.namelist()} == members


def test_a_zip_of_more_than_four_gigabytes_and_many_members(tmp_path: Path) -> None:
    path = tmp_path / "large.zip"
    with ZipSink(path) as sink:
        sink.put("data/a/0.0", b"near")
        # A hole that takes no space on the disk.
        sink._file.seek(5 << 30)
        sink._offset = 5 << 30
        for row in range(1, 70_000):
            sink.put(f"data/a/{row}.0", b"far")
    table = read_index(path).chunks["data/a", "0"]
    assert len(table) == 70_000
    assert [content_of(path, table[i]) for i in (0, 69_999)] == [b"near", b"far"]
    with zipfile.ZipFile(path) as archive:
        assert archive.read("data/a/69999.0") == b"far"


@pytest.mark.parametrize("kept", [0, 10, 200, -1, -30])
def test_a_zip_that_is_cut_short_is_refused(tmp_path: Path, kept: int) -> None:
    path = write_zip(tmp_path / "a.zip", {f"data/a/{i}.0": b"x" * 50 for i in range(9)})
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(SourceError, match="directory"):
        read_index(path)


@pytest.mark.parametrize("seed", range(40))
def test_a_garbled_zip_gives_an_error_or_members(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = write_zip(tmp_path / "a.zip", {f"data/a/{i}.0": b"x" * 20 for i in range(9)})
    raw = bytearray(path.read_bytes())
    for at in rng.integers(len(raw) // 3, len(raw), 4):
        raw[at] = rng.integers(256)
    path.write_bytes(raw)
    try:
        for table in read_index(path).chunks.values():
            for record in table:
                assert content_of(path, record) == b"x" * 20
    except ExumiError:
        pass


def test_a_damaged_member_is_found_by_its_checksum(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"data/a/0.0": b"abcdefgh"})
    path.write_bytes(path.read_bytes().replace(b"abcdefgh", b"abcdXfgh"))
    (record,) = read_index(path).chunks["data/a", "0"]
    with pytest.raises(SourceError, match="checksum"):
        content_of(path, record)


def test_a_bomb_is_unpacked_to_what_it_claims_and_no_further(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"data/a/0.0": b"\0" * 50_000_000}, zipfile.ZIP_DEFLATED)
    raw = path.read_bytes()
    path.write_bytes(raw.replace(struct.pack("<L", 50_000_000), struct.pack("<L", 100)))
    (record,) = read_index(path).chunks["data/a", "0"]
    with pytest.raises(SourceError, match="checksum"):
        content_of(path, record)


def test_a_member_that_claims_too_much_is_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"data/a/0.0": b"x" * 12_345})
    raw = path.read_bytes()
    path.write_bytes(raw.replace(struct.pack("<L", 12_345), struct.pack("<L", 1 << 30)))
    with pytest.raises(LimitError):
        read_index(path)


def test_a_directory_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_zip(tmp_path / "a.zip", {f"{i}/.zarray": b"" for i in range(40)})
    monkeypatch.setattr(zip_index, "_MAX_DOCUMENTS", 30)
    with pytest.raises(LimitError):
        read_index(path)
    monkeypatch.setattr(zip_index, "_MAX_DIRECTORY", 100)
    with pytest.raises(LimitError):
        read_index(path)


def test_what_is_no_part_of_an_array_does_not_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zip_index, "MAX_MEMBER", 99)
    monkeypatch.setattr(zip_index, "_MAX_DOCUMENTS", 2)
    members = {"video.mp4": bytes(999), **{f"{i}.png": b"" for i in range(9)}, ".zattrs": b"{}"}
    assert list(read_index(write_zip(tmp_path / "a.zip", members)).documents) == [".zattrs"]


def test_a_chunk_has_one_name(tmp_path: Path) -> None:
    others = ("٣.0", "003.0", "3.00", "3.٣", "3.", "3..0", "+3.0", "3.-1", f"{'9' * 18}.0")
    names = ["a/3.0", *(f"a/{name}" for name in others)]
    index = read_index(write_zip(tmp_path / "a.zip", dict.fromkeys(names, b"x")))
    assert {key: table["row"].tolist() for key, table in index.chunks.items()} == {("a", "0"): [3]}


def test_an_encrypted_member_is_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"data/a/0.0": b"x"})
    raw = bytearray(path.read_bytes())
    raw[raw.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(raw)
    with pytest.raises(SourceError, match="encrypted"):
        read_index(path)


def test_a_zip_is_known_by_its_first_bytes(tmp_path: Path) -> None:
    (tmp_path / "b.zip").write_bytes(b"no")
    assert not is_zip(tmp_path / "b.zip")
    assert not is_zip(tmp_path)
    assert is_zip(write_zip(tmp_path / "a.zarr", {"x": b""}))
