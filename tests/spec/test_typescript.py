"""The second reader, built and run: what it refuses, and what happens without Node.js."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

READERS = Path(__file__).resolve().parents[2] / "spec" / "readers"
MAIN = READERS / "typescript" / "dist" / "main.js"
built = pytest.mark.skipif(
    not MAIN.is_file() or shutil.which("node") is None,
    reason="needs Node.js and `make readers`, which builds the second reader",
)


def read(store: Path) -> subprocess.CompletedProcess[str]:
    command = ["node", str(MAIN), str(store)]
    return subprocess.run(command, check=False, capture_output=True, text=True)


@pytest.fixture
def store(corpus: Path, tmp_path: Path) -> Path:
    """A copy of a valid episode with a calibration array."""
    target = tmp_path / "store.zarr"
    shutil.copytree(corpus / "valid" / "calibration__array" / "store.zarr", target)
    return target


@built
@pytest.mark.parametrize(
    "path", ["calibration/../../outside", "../outside", "/etc", "a\\b", "streams"]
)
def test_paths_that_lead_out_are_refused(store: Path, path: str) -> None:
    shutil.copytree(store, store.parent / "outside")
    root = json.loads((store / "zarr.json").read_bytes())
    items = root["attributes"]["exumi"]["calibration"].values()
    item = next(item for item in items if "array" in item)
    item["array"] = path
    (store / "zarr.json").write_text(json.dumps(root))
    done = read(store)
    assert done.returncode == 1
    assert "unsafe path" in done.stderr or "not below calibration/" in done.stderr


@built
def test_links_are_refused(store: Path) -> None:
    assert read(store).returncode == 0
    (store / "streams" / "link").symlink_to(store / "zarr.json")
    done = read(store)
    assert done.returncode == 1
    assert "streams/link is a link" in done.stderr


@built
def test_what_cannot_be_listed_is_not_an_empty_dataset(corpus: Path, tmp_path: Path) -> None:
    dataset = tmp_path / "dataset"
    shutil.copytree(corpus / "valid" / "dataset__empty" / "dataset", dataset)
    shutil.rmtree(dataset / "episodes", ignore_errors=True)
    assert read(dataset).returncode == 0
    (dataset / "episodes").write_text("")
    done = read(dataset)
    assert done.returncode == 1
    assert "ENOTDIR" in done.stderr


@built
@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("short_compressed", "streams/pose/time: a chunk has 24 bytes, expected 32"),
        ("long_compressed", "streams/pose/time: a chunk has 40 bytes, expected 32"),
        ("short_uncompressed", "streams/rgb/data: a chunk has 12 bytes, expected 16"),
        ("long_uncompressed", "streams/rgb/data: a chunk has 20 bytes, expected 16"),
    ],
)
def test_a_chunk_of_another_length_is_refused(corpus: Path, case: str, message: str) -> None:
    done = read(corpus / "invalid" / f"SHARD-005__{case}" / "store.zarr")
    assert (done.returncode, done.stderr) == (1, f"refused: {message}\n")


@pytest.mark.parametrize(
    ("options", "code", "word"), [((), 0, "SKIPPED"), (("--require",), 1, "FAILED")]
)
def test_without_node_it_is_said(
    tmp_path: Path, options: tuple[str, ...], code: int, word: str
) -> None:
    command = [sys.executable, str(READERS / "check_typescript.py"), *options]
    environment = os.environ | {"PATH": str(tmp_path)}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == code
    assert done.stderr.startswith(word)
