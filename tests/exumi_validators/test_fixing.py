"""What can be mended is mended; evidence stays, and a dry run writes nothing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from exumi_data.catalog import CATALOG_NAME, list_episodes, read_catalog, write_catalog
from exumi_data.errors import UsageError
from exumi_validators import validate
from exumi_validators.fixing import CatalogFix, apply_fix, plan_fix
from tests.exumi_data.builders import edit_metadata, write_dataset


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "dataset", 3)


def table(dataset: Path) -> Any:
    found = read_catalog(dataset)
    assert found is not None
    return found


def files(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(path): (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file()
    }


def catalog_codes(dataset: Path) -> set[str]:
    return {code for code in validate(dataset).codes() if code.startswith("CAT-")}


def spoil_bytes(dataset: Path, number: int = 0) -> str:
    """Change a byte of an episode so that it still reads; return its path."""
    path = list_episodes(dataset)[number]
    (dataset / path / "streams" / "width" / "data" / "note").write_bytes(b"x")
    return path


def test_nothing_to_mend(dataset: Path) -> None:
    before = files(dataset)
    fix = apply_fix(dataset)
    assert not fix.needed
    assert fix.to_text(applied=True) == "catalog.parquet: nothing to mend\n"
    assert files(dataset) == before


@pytest.mark.parametrize("spoil", ["missing", "damaged", "lacks a row", "unsorted", "wrong column"])
def test_a_wrong_catalog_is_made_again(spoil: str, dataset: Path) -> None:
    right = table(dataset)
    file = dataset / CATALOG_NAME
    if spoil == "missing":
        file.unlink()
    elif spoil == "damaged":
        file.write_bytes(b"PAR1 no")
    elif spoil == "lacks a row":
        write_catalog(dataset, right.slice(1))
    elif spoil == "unsorted":
        write_catalog(dataset, right.take([2, 0, 1]))
    else:
        names = pa.array(["wrong"] * 3, pa.string())
        column = right.column_names.index("object_id")
        write_catalog(dataset, right.set_column(column, "object_id", names))
    assert ("CAT-005" in catalog_codes(dataset)) == (spoil == "unsorted")
    before = files(dataset)
    planned = plan_fix(dataset)
    assert planned.needed
    assert "Nothing was written yet" in planned.to_text(applied=False)
    assert files(dataset) == before
    assert apply_fix(dataset) == planned
    assert table(dataset).equals(right)
    assert catalog_codes(dataset) == set()
    assert not plan_fix(dataset).needed


def test_changed_bytes_are_evidence(dataset: Path) -> None:
    path = spoil_bytes(dataset)
    known = table(dataset)
    write_catalog(dataset, known.slice(0, 2))  # something else to mend besides
    fix = apply_fix(dataset)
    assert fix.changed == (path,)
    assert fix.needed
    assert "--accept-changed" in fix.to_text(applied=True)
    assert table(dataset).equals(known), "the row of the changed episode is the old one"
    assert catalog_codes(dataset) == {"CAT-004"}
    accepted = apply_fix(dataset, accept_changed=True)
    assert accepted.updated == (path,)
    assert catalog_codes(dataset) == set()


def test_evidence_in_a_catalog_of_other_columns_blocks_everything(dataset: Path) -> None:
    spoil_bytes(dataset)
    pq.write_table(table(dataset).drop_columns(["trial"]), dataset / CATALOG_NAME)
    before = files(dataset)
    fix = apply_fix(dataset)
    assert fix.blocked is not None
    assert not fix.needed
    assert files(dataset) == before
    assert apply_fix(dataset, accept_changed=True).needed
    assert read_catalog(dataset) is not None


def test_new_metadata_is_no_evidence(dataset: Path) -> None:
    path = list_episodes(dataset)[1]
    edit_metadata(dataset / path, lambda exumi: exumi.update(revision=2, site="lab"))
    fix = apply_fix(dataset)
    assert (fix.updated, fix.changed) == ((path,), ())
    assert catalog_codes(dataset) == set()


def test_an_unreadable_episode_is_named_and_its_row_stays(dataset: Path) -> None:
    path = list_episodes(dataset)[0]
    (dataset / path / "zarr.json").write_text("{")
    write_catalog(dataset, table(dataset).take([1, 0, 2]))
    fix = apply_fix(dataset)
    assert list(fix.unreadable) == [path]
    assert "cannot be read" in fix.to_text(applied=True)
    assert table(dataset).column("path").to_pylist() == list_episodes(dataset)


def test_columns_of_others_are_named_before_they_are_dropped(dataset: Path) -> None:
    right = table(dataset)
    more = right.append_column("mine", pa.array([1, 2, 3]))
    pq.write_table(more, dataset / CATALOG_NAME)
    fix: CatalogFix = plan_fix(dataset)
    assert fix.dropped_columns == ("mine",)
    assert "drop the columns mine" in fix.to_text(applied=False)


def test_only_datasets_are_mended(dataset: Path) -> None:
    with pytest.raises(UsageError, match="only a dataset's catalog"):
        plan_fix(dataset / list_episodes(dataset)[0])


def link(catalog: Path) -> None:
    catalog.rename(catalog.with_name("elsewhere"))
    catalog.symlink_to("elsewhere")


def folder(catalog: Path) -> None:
    catalog.unlink()
    catalog.mkdir()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (link, "catalog.parquet is a link: it is neither followed nor replaced"),
        (folder, "catalog.parquet is no file"),
    ],
)
def test_what_is_no_file_of_its_own_is_not_replaced(
    make: Callable[[Path], None], message: str, dataset: Path
) -> None:
    catalog = dataset / CATALOG_NAME
    right = table(dataset)
    make(catalog)
    before = sorted(path.name for path in dataset.iterdir())
    fix = apply_fix(dataset, accept_changed=True)
    assert not fix.needed
    assert fix.to_text(applied=True) == f"catalog.parquet: not mended\n  {message}\n"
    with pytest.raises(UsageError, match=message):
        write_catalog(dataset, right)
    assert sorted(path.name for path in dataset.iterdir()) == before
    assert not catalog.is_file() or catalog.is_symlink()
    (found,) = [p for p in validate(dataset).problems if p.code == "CAT-001"]
    assert found.message == message


def test_many_unreadable_episodes_make_no_endless_text(dataset: Path) -> None:
    for number in range(30):
        (dataset / "episodes" / "aa" / f"{number}.zarr").mkdir(parents=True)
    fix = plan_fix(dataset)
    assert len(fix.unreadable) == 30
    lines = fix.to_text(applied=False).splitlines()
    assert lines[-1] == "  not mended: 10 more"
    assert len(lines) == 22
    assert "0.zarr cannot be read: no zarr.json" in lines[1]
