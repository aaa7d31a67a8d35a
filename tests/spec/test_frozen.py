"""Files of 1.0, as its writers made them: never changed, and read by every later version."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from zarr.storage import ZipStore

import exumi_data
from exumi_validators import validate
from tests.spec.test_dump import COMPARE, DUMP

FROZEN = Path(__file__).resolve().parents[2] / "spec" / "frozen" / "1.0"
# Of the list itself: whoever changes a frozen file and the list still has to explain it here.
LIST_SHA256 = "e72b5806b95b69fe8aee93ecf0da07c4fecaac3a7a0457b4fa9aa946f2a4dc92"
CASES = sorted(path.parent for path in FROZEN.glob("valid/*/expected.json"))


def listed() -> dict[str, str]:
    lines = (FROZEN / "sha256.txt").read_text("utf-8").splitlines()
    return {path: digest for digest, _, path in (line.partition("  ") for line in lines)}


def store_of(case: Path) -> Path:
    return case / str(json.loads((case / "expected.json").read_bytes())["store"])


def changes(folder: Path, wanted: dict[str, str]) -> list[str]:
    """Paths that are not as they are listed."""
    files = {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}
    files.pop("sha256.txt", None)
    there = {path: hashlib.sha256(file.read_bytes()).hexdigest() for path, file in files.items()}
    return sorted(path for path in there | wanted if there.get(path) != wanted.get(path))


def test_no_frozen_file_was_changed() -> None:
    content = (FROZEN / "sha256.txt").read_bytes()
    assert hashlib.sha256(content).hexdigest() == LIST_SHA256
    assert len(listed()) > 50
    assert changes(FROZEN, listed()) == []


def test_a_change_is_found(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("1")
    (tmp_path / "b").write_text("2")
    wanted = {"a": hashlib.sha256(b"0").hexdigest(), "c": "0"}
    assert changes(tmp_path, wanted) == ["a", "b", "c"]


def test_they_are_small() -> None:
    assert sum(path.stat().st_size for path in FROZEN.rglob("*") if path.is_file()) < 600_000


def test_they_are_not_written_again() -> None:
    command = [sys.executable, str(FROZEN.parent / "make_frozen.py")]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert "never written again" in done.stderr


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_they_read_as_they_did(case: Path) -> None:
    store = store_of(case)
    dump = DUMP.dump_dataset(store) if store.name == "dataset" else DUMP.dump_episode(store)
    stored = json.loads((case / "dump.json").read_bytes())
    assert list(COMPARE.differences(stored, dump)) == []


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_they_are_valid(case: Path) -> None:
    report = validate(store_of(case))
    assert [problem for problem in report.problems if problem.severity == "error"] == []
    assert report.valid


@pytest.mark.parametrize(
    "case", [c for c in CASES if store_of(c).suffix == ".zip"], ids=lambda case: case.name
)
def test_plain_zarr_reads_the_same(case: Path) -> None:
    dump = json.loads((case / "dump.json").read_bytes())
    wanted = {
        f"streams/{stream['name']}/{array['name']}": array["sha256"]
        for stream in dump["streams"]
        for array in stream["arrays"]
    }
    wanted |= {array["path"]: array["sha256"] for array in dump["arrays"]}
    with ZipStore(store_of(case), mode="r") as store:
        group = zarr.open_group(store, mode="r", zarr_format=3)
        for path, digest in wanted.items():
            array = group[path]
            assert isinstance(array, zarr.Array)
            values: Any = np.asarray(array[...])
            assert hashlib.sha256(values.tobytes()).hexdigest() == digest, path


def test_the_dataset_opens_with_its_catalog_and_split() -> None:
    dataset = exumi_data.open(FROZEN / "valid" / "dataset__split" / "dataset")
    assert isinstance(dataset, exumi_data.Dataset)
    assert len(dataset) == 2
    lists = dataset.splits["default"].lists
    assert sorted(id_ for ids in lists.values() for id_ in ids) == sorted(dataset.ids)
    assert [len(episode["tactile_left"].frames) for episode in dataset] == [5, 5]
