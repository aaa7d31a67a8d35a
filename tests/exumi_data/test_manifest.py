"""A manifest says what a dataset holds, the same wherever it lies, and changes with every byte."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from exumi_data.catalog import episode_path
from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError, MetadataError, UsageError
from exumi_data.manifest import (
    MANIFEST_NAME,
    build_manifest,
    check_listable,
    is_listed,
    sha256_of,
    write_manifest,
)
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, dump, parse_manifest
from exumi_data.store.pack import pack
from exumi_validators import validate
from tests.exumi_data.builders import copy_of, episode_id, write_dataset

FIRST = episode_path(episode_id(0))


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write_dataset(tmp_path_factory.mktemp("original") / "d", 2)
    second = root / episode_path(episode_id(1))
    pack(second)
    for path in sorted(second.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    second.rmdir()
    (root / "catalog.parquet").unlink()
    (root / "README.md").write_text("Clips.\n")
    (root / ".hidden").mkdir()
    (root / ".hidden" / "x").write_text("x")
    return root


@pytest.fixture
def dataset(original: Path, tmp_path: Path) -> Path:
    return copy_of(original, tmp_path / "d")


def found(root: Path) -> set[str]:
    report = validate(root)
    assert report.coverage.unchecked == ()
    return {code for code in report.codes() if code.startswith(("MAN", "META", "DOC"))}


def test_it_lists_every_file_with_its_digest(dataset: Path) -> None:
    manifest = build_manifest(dataset)
    files = [p.relative_to(dataset).as_posix() for p in dataset.rglob("*") if p.is_file()]
    assert [f.path for f in manifest.files] == sorted(p for p in files if ".hidden" not in p)
    for file in manifest.files:
        assert (file.sha256, file.bytes) == sha256_of(dataset / file.path)
    assert [entry.path for entry in manifest.episodes] == sorted(
        p.relative_to(dataset).as_posix() for p in dataset.glob("episodes/*/*")
    )
    for entry in manifest.episodes:
        with open_episode(dataset / entry.path) as episode:
            assert (entry.id, entry.digest) == (episode.id, episode.digest())


def test_it_is_the_same_elsewhere_and_does_not_list_itself(dataset: Path, tmp_path: Path) -> None:
    first = dump(build_manifest(dataset))
    write_manifest(dataset)
    assert dump(build_manifest(copy_of(dataset, tmp_path / "other"))) == first
    raw = (dataset / MANIFEST_NAME).read_bytes()
    assert dump(parse_manifest(raw, "here")) == first


def test_a_dataset_agrees_with_its_own_manifest(dataset: Path) -> None:
    write_manifest(dataset)
    assert found(dataset) == set()


def append(root: Path, path: str) -> None:
    with (root / path).open("ab") as file:
        file.write(b" ")


def flip(root: Path, path: str) -> None:
    data = bytearray((root / path).read_bytes())
    data[-3] ^= 0x20
    (root / path).write_bytes(data)


def link(root: Path) -> None:
    (root / "README.md").rename(root / ".readme")
    (root / "README.md").symlink_to(".readme")


SPOILED: dict[str, tuple[Callable[[Path], object], set[str]]] = {
    "longer": (lambda root: append(root, "README.md"), {"MAN-003"}),
    "changed": (lambda root: flip(root, "README.md"), {"MAN-004"}),
    "gone": (lambda root: (root / "README.md").unlink(), {"MAN-001"}),
    "new": (lambda root: (root / "LICENSE").write_text("MIT"), {"MAN-002"}),
    "hidden": (lambda root: (root / ".DS_Store").write_text("x"), set()),
    "linked": (link, {"MAN-001"}),
    "data": (lambda root: flip(root, f"{FIRST}/streams/width/data/c/0"), {"MAN-004", "MAN-006"}),
    "derived": (lambda root: flip(root, f"{FIRST}/derived/tactile/activity/c/0"), {"MAN-004"}),
}  # fmt: skip


@pytest.mark.parametrize("what", SPOILED)
def test_whatever_changes_is_found(dataset: Path, what: str) -> None:
    write_manifest(dataset)
    spoil, codes = SPOILED[what]
    spoil(dataset)
    assert found(dataset) == codes


def test_sizes_are_told_without_reading(dataset: Path) -> None:
    write_manifest(dataset)
    append(dataset, "README.md")
    flip(dataset, "dataset.json")
    assert set(validate(dataset, levels=["hierarchy"]).codes()) == {"CAT-001", "MAN-003"}


def test_a_link_is_refused(dataset: Path) -> None:
    link(dataset)
    with pytest.raises(DamagedDataError, match=r"README\.md: is a link"):
        build_manifest(dataset)


def test_a_pipe_is_not_waited_for(dataset: Path) -> None:
    os.mkfifo(dataset / "pipe")
    with pytest.raises(DamagedDataError, match="is no file"):
        build_manifest(dataset)


def test_a_half_written_episode_cannot_be_released(dataset: Path) -> None:
    (dataset / FIRST / "zarr.json").unlink()
    with pytest.raises(DamagedDataError, match=r"has no zarr\.json"):
        build_manifest(dataset)


def test_names_that_are_no_text_are_refused(dataset: Path) -> None:
    Path(os.fsdecode(os.fsencode(dataset) + b"/\xff")).write_text("")
    with pytest.raises(DamagedDataError, match="unsafe path"):
        build_manifest(dataset)


@pytest.mark.parametrize(
    ("path", "listed"),
    [
        ("dataset.json", True),
        ("manifest.json", False),
        ("episodes/manifest.json", True),
        (".git/config", False),
        ("episodes/a1/.partial-x/zarr.json", False),
    ],
)
def test_what_is_listed(path: str, listed: bool) -> None:
    assert is_listed(path) is listed


def test_a_file_with_another_key_is_refused() -> None:
    document = {"format": "exumi-manifest", "version": "1.0", "files": [], "episodes": [], "x": 1}
    with pytest.raises(MetadataError, match="unknown key"):
        parse_manifest(json.dumps(document).encode(), "here")


def test_it_can_be_written_again(dataset: Path) -> None:
    first = write_manifest(dataset).read_bytes()
    (dataset / "README.md").write_text("More clips.\n")
    assert write_manifest(dataset).read_bytes() != first
    assert found(dataset) == set()


def test_a_link_in_its_place_is_not_replaced(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_text("mine")
    (dataset / MANIFEST_NAME).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match="is a link"):
        write_manifest(dataset)
    assert (tmp_path / "elsewhere").read_text() == "mine"


def test_more_episodes_than_it_can_list_are_refused_before_they_are_packed() -> None:
    entry = {"path": episode_path(episode_id(0), packed=True), "sha256": "0" * 64, "bytes": 1000}
    one = {"id": episode_id(0), "path": entry["path"], "digest": "0" * 64}
    text = [json.dumps({"files": [entry] * n, "episodes": [one] * n}, indent=1) for n in (1, 2)]
    least = len(text[1]) - len(text[0])
    check_listable(MAX_DOCUMENT_BYTES // least, "set")
    with pytest.raises(UsageError, match=r"has 86,259 episodes; a manifest lists 86,258 at most"):
        check_listable(86_259, "set")
