"""A flipped byte of an index is found: in its vectors when they are searched, or by verifying."""

from pathlib import Path

import numpy as np
import pytest

from exumi_data.errors import DamagedDataError, NotAnEpisodeError
from exumi_loaders import Entry, TactileIndex, verify_index
from exumi_loaders.retrieval.document import EncoderStatement, IndexDocument
from exumi_loaders.retrieval.folder import write_document
from exumi_loaders.retrieval.segments import write_segment
from exumi_loaders.retrieval.space import unit
from tests.exumi_loaders.retrieval.gratings import REST, pressed

WIDTH = 512
ROWS = 20_000  # 39 MiB: two files


def flip(file: Path, at: int) -> None:
    with file.open("r+b") as opened:
        opened.seek(at)
        (byte,) = opened.read(1)
        opened.seek(at)
        opened.write(bytes([byte ^ 1]))


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("large") / "index"
    root.mkdir()
    vectors = unit(np.random.default_rng(0).standard_normal((ROWS, WIDTH), np.float32))
    segment = write_segment(root, vectors, [Entry(f"e{n}/t", f"x{n}") for n in range(ROWS)])
    encoder = EncoderStatement(name="e/1", digest="e/1", dimension=WIDTH)
    document = IndexDocument(encoder=encoder, frames=10, dimension=WIDTH, segments=[segment])
    write_document(root, document)
    return root


def files_of(root: Path) -> list[Path]:
    """The files of vectors, those of the build."""
    return sorted(path for path in root.glob("segments/*/embeddings/c/*/0") if path.is_file())


def test_a_flipped_byte_is_found_when_it_is_searched(large: Path) -> None:
    asked = unit(np.random.default_rng(1).standard_normal((1, WIDTH), np.float32))
    assert verify_index(large) == []
    before = TactileIndex.open(large).search(asked)
    first, second = files_of(large)
    at = (ROWS - first.stat().st_size // (4 * WIDTH)) * WIDTH  # somewhere in the last rows
    flip(second, at)
    try:
        opened = TactileIndex.open(large)  # reads no vector
        assert opened.info().entries == ROWS
        with pytest.raises(DamagedDataError, match="wrong checksum") as caught:
            opened.search(asked)
        assert caught.value.where == str(second)
        (found,) = verify_index(large)
        assert found.where == str(second)
        flip(first, 0)
        assert [error.where for error in verify_index(large)] == [str(first), str(second)]
        flip(first, 0)
    finally:
        flip(second, at)
    again = TactileIndex.open(large).search(asked)
    np.testing.assert_array_equal(again[1], before[1])


def test_what_fills_the_last_chunk_up_is_nobodys(large: Path) -> None:
    (_, second) = files_of(large)
    rows_there = ROWS - (32 << 20) // (4 * WIDTH)
    flip(second, rows_there * 4 * WIDTH + 5)
    try:
        assert verify_index(large) == []
    finally:
        flip(second, rows_there * 4 * WIDTH + 5)


@pytest.mark.parametrize("taught", [False, True])
def test_a_small_index_is_checked_as_well(index: TactileIndex, taught: bool) -> None:
    if taught:  # small neighbours are put together in memory
        index.teach([(pressed(11, 1), REST)], name="new")
        index.teach([(pressed(11, 2), REST)], name="newer")
    file = max(files_of(index.path), key=lambda path: path.stat().st_mtime_ns)
    flip(file, 40)
    assert [error.where for error in verify_index(index.path)] == [str(file)]
    with pytest.raises(DamagedDataError, match="wrong checksum"):
        TactileIndex.open(index.path).query(pressed(11, 3), REST)


def test_damage_is_not_copied_when_lessons_are_put_together(
    index: TactileIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The copy would have a checksum that is right."""
    monkeypatch.setattr("exumi_loaders.retrieval.changes._MOST_SMALL", 1)
    index.teach([(pressed(11, 1), REST)], name="new")
    (name,) = [segment.name for segment in index.document.segments[1:]]
    flip(index.path / "segments" / name / "embeddings/c/0/0", 3)
    with pytest.raises(DamagedDataError, match="wrong checksum"):
        index.teach([(pressed(11, 2), REST)], name="newer")
    assert index.info().entries == 13


def test_every_damaged_file_is_named(index: TactileIndex, tmp_path: Path) -> None:
    index.teach([(pressed(11, 1), REST)], name="new")
    segment = index.path / "segments" / index.document.segments[0].name
    (segment / "entries.parquet").unlink()
    flip(index.path / "space/mean/c/0/0", 30)
    taught = index.path / "segments" / index.document.segments[1].name
    document = taught / "embeddings/zarr.json"
    document.write_text(document.read_text().replace("float32", "float30"))
    where = [str(error.where) for error in verify_index(index.path)]
    assert len(where) == 3
    assert "space/mean" in where[0]
    assert where[1] == str(segment / "entries.parquet")
    assert where[2] == str(taught / "embeddings")
    (index.path / "index.json").write_text("{")
    (found,) = verify_index(index.path)
    assert "index.json" in str(found.where)
    with pytest.raises(NotAnEpisodeError):
        verify_index(tmp_path / "nothing")
