import json
from pathlib import Path

from exumi_data.manifest import build_manifest
from exumi_data.release.describing import describe
from tests.exumi_data.builders import write_dataset


def files(root: Path) -> dict[str, bytes]:
    found = (path for path in root.rglob("*") if path.is_file())
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in found}


def test_what_is_written_before_the_manifest(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 2, authors=["Ada Lovelace"])
    before = files(root)
    written = describe(root, [])
    after = files(root)
    assert {*after} - {*before} == {*written}
    assert {"README.md", "CITATION.cff", "croissant.json", "pictures/touch.png"} <= {*written}
    assert {name: after[name] for name in before} == before
    listed = {one.path for one in build_manifest(root).files}
    assert {*written} <= listed
    assert "manifest" not in json.dumps(json.loads(after["croissant.json"])["distribution"])
    # What is there already plays no part: a second time gives the same.
    assert describe(root, []) == written
    assert files(root) == after


def test_without_authors(tmp_path: Path) -> None:
    assert "CITATION.cff" not in describe(write_dataset(tmp_path / "set", 1))
