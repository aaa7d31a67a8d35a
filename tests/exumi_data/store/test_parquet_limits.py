"""Small catalogs that ask for much are told before they are read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from exumi_data.catalog import CATALOG_NAME, read_catalog
from exumi_data.store.parquet_limits import footer_mistake, pages_mistake
from exumi_validators import validate
from tests.exumi_data.builders import write_dataset

LONG = "x" * 1_000_000


def write(path: Path, table: "pa.Table", **options: Any) -> Path:
    pq.write_table(table, path, **options)
    return path


def mistake(path: Path) -> str | None:
    found = footer_mistake(path)
    return found or pages_mistake(path, pq.read_metadata(path))


def repeated(path: Path) -> None:
    """A thousand rows of a megabyte each, all of them one entry of a dictionary."""
    ids = pa.DictionaryArray.from_arrays(pa.array([0] * 1000, pa.int32()), [LONG])
    write(path, pa.table({"id": ids}), dictionary_pagesize_limit=2 << 20, store_schema=False)


def a_long_row(path: Path) -> None:
    """One row with a list of fifty million numbers."""
    values = pa.Array.from_buffers(pa.int64(), 50_000_000, [None, pa.py_buffer(bytes(400_000_000))])
    offsets = pa.array([0, len(values)], pa.int32())
    write(path, pa.table({"id": pa.ListArray.from_arrays(offsets, values)}), compression="zstd")


def growing(path: Path) -> None:
    """Strings that each repeat the one before: an encoding whose bounds nobody can tell."""
    table = pa.table({"id": pa.array([LONG + str(number) for number in range(20)])})
    write(path, table, use_dictionary=False, column_encoding={"id": "DELTA_BYTE_ARRAY"})


BOMBS: dict[Callable[[Path], None], str] = {
    repeated: "asks for more memory",
    a_long_row: "asks for more memory",
    growing: "encoding 7",
}


@pytest.mark.parametrize("make", BOMBS)
def test_a_small_file_cannot_ask_for_much(tmp_path: Path, make: Callable[[Path], None]) -> None:
    root = write_dataset(tmp_path / "d", 1)
    make(root / CATALOG_NAME)
    assert (root / CATALOG_NAME).stat().st_size < 5_000_000
    assert BOMBS[make] in str(mistake(root / CATALOG_NAME))
    assert read_catalog(root) is None
    (found,) = [p for p in validate(root).problems if p.code == "CAT-001"]
    assert "catalog.parquet" in found.message


@pytest.mark.parametrize("compression", ["none", "snappy", "gzip", "zstd", "brotli", "lz4"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_ordinary_files_of_every_writer_are_read(
    tmp_path: Path, compression: str, version: str
) -> None:
    table = pa.table(
        {
            "id": [f"name {number % 100}" for number in range(20_000)],
            "list": [[number] * (number % 3) for number in range(20_000)],
            "flag": [True, None] * 10_000,
            "value": [0.5] * 20_000,
        }
    )
    options = {"compression": compression, "data_page_version": version, "row_group_size": 7000}
    path = write(tmp_path / "a.parquet", table, **options)
    assert mistake(path) is None


def test_a_catalog_of_many_episodes_is_read(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 1)
    table = read_catalog(root)
    assert table is not None
    many = pa.concat_tables([table] * 50_000).combine_chunks()
    assert mistake(write(tmp_path / "a.parquet", many, compression="zstd")) is None


def test_a_footer_that_claims_gigabytes_is_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.parquet", pa.table({"id": ["a"]}))
    data = path.read_bytes()
    path.write_bytes(data[:-8] + (1 << 31).to_bytes(4, "little") + b"PAR1")
    assert mistake(path) == "its footer has 2,147,483,648 bytes"
    path.write_bytes(b"PAR1 and no more")
    assert mistake(path) == "it is no Parquet file"


def test_every_changed_byte_of_a_header_is_a_mistake_or_none(tmp_path: Path) -> None:
    path = write(tmp_path / "a.parquet", pa.table({"id": ["a", "b", "a"]}))
    data = path.read_bytes()
    metadata = pq.read_metadata(path)
    told = 0
    for at in range(4, 80):
        for value in (0, 0x7F, 0xFF):
            path.write_bytes(data[:at] + bytes([value]) + data[at + 1 :])
            told += pages_mistake(path, metadata) is not None
    assert told > 50


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    import os

    root = write_dataset(tmp_path / "d", 1, catalog=False)
    os.mkfifo(root / CATALOG_NAME)
    assert read_catalog(root) is None
    assert set(validate(root).codes()) >= {"CAT-001", "SAFE-002"}


def test_ids_that_are_none_make_no_catalog(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 2)
    table = read_catalog(root)
    assert table is not None
    wrong = table.set_column(0, table.schema.field("id"), pa.array(["../x", "y"]))
    pq.write_table(wrong, root / CATALOG_NAME)
    assert read_catalog(root) is None
