import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from exumi_data.catalog import build_catalog, rows_to_table, write_catalog
from exumi_data.errors import NotAnEpisodeError, UsageError
from exumi_data.manifest import write_manifest
from exumi_data.release.verify_state import VerifyState, state_folder
from exumi_data.release.verifying import Verification, verify_release
from exumi_data.stopping import Stopped
from tests.exumi_data.builders import write_dataset
from tests.exumi_data.release.making import Release, tree


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXUMI_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def copy(source: Path, tmp_path: Path, release: Release) -> Path:
    release(source, tmp_path / "out", preview_bytes=0)
    return tmp_path / "out"


def found(root: Path, *, quick: bool = False) -> list[tuple[str, str]]:
    return [(one.kind, one.path) for one in verify_release(root, quick=quick, workers=1).findings]


def an_episode(root: Path) -> Path:
    return min(root.glob("episodes/*/*.zip"))


def flip(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 0x10
    path.write_bytes(content)


def test_all_is_well(copy: Path) -> None:
    before = tree(copy)
    result = verify_release(copy, workers=1)
    assert result.good
    assert (result.episodes, result.version, result.quick) == (3, "1.0.0", False)
    assert result.bytes == sum(len(one) for name, one in before.items() if name != "manifest.json")
    assert tree(copy) == before
    assert not list(state_folder().iterdir())


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_one_flipped_bit(copy: Path, place: int) -> None:
    path = an_episode(copy)
    flip(path, place * (path.stat().st_size - 1) // 3)
    assert ("changed", path.relative_to(copy).as_posix()) in found(copy)


@pytest.mark.parametrize("name", ["dataset.json", "catalog.parquet", "LICENSE", "CHANGELOG.md"])
def test_a_flipped_bit_beside_the_episodes(copy: Path, name: str) -> None:
    flip(copy / name, 8)
    assert ("changed", name) in found(copy)


def test_a_missing_file(copy: Path) -> None:
    path = an_episode(copy)
    path.unlink()
    for quick in (False, True):
        assert ("missing", path.relative_to(copy).as_posix()) in found(copy, quick=quick)


@pytest.mark.parametrize("name", ["notes.txt", "episodes/00/more.txt"])
def test_an_extra_file(copy: Path, name: str) -> None:
    (copy / name).parent.mkdir(exist_ok=True)
    (copy / name).touch()
    for quick in (False, True):
        assert found(copy, quick=quick) == [("extra", name)]


@pytest.mark.parametrize("name", [rb"extra\file.txt", b"caf\xe9.txt"])
def test_a_file_with_an_odd_name_hides_nothing(copy: Path, name: bytes) -> None:
    Path(os.fsdecode(os.fsencode(copy) + b"/" + name)).touch()
    flip(copy / "LICENSE", 8)
    episode = an_episode(copy)
    flip(episode, 100)
    damaged = {("changed", "LICENSE"), ("changed", episode.relative_to(copy).as_posix())}
    result = set(found(copy))
    assert damaged < result
    (odd,) = result - damaged
    assert odd == ("unreadable", str(copy))


def test_hidden_files_play_no_part(copy: Path) -> None:
    (copy / ".gitattributes").write_text("*.zip filter=lfs")
    assert not found(copy)


def test_a_file_cut_short(copy: Path) -> None:
    path = an_episode(copy)
    path.write_bytes(path.read_bytes()[:-1])
    for quick in (False, True):
        assert ("size", path.relative_to(copy).as_posix()) in found(copy, quick=quick)


def test_a_link_is_no_file(copy: Path, tmp_path: Path) -> None:
    path = an_episode(copy)
    path.rename(tmp_path / "elsewhere.zip")
    path.symlink_to(tmp_path / "elsewhere.zip")
    assert ("changed", path.relative_to(copy).as_posix()) in found(copy)


def edited(root: Path, change: Callable[[dict[str, list[dict[str, str]]]], None]) -> None:
    path = root / "manifest.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_a_manifest_that_was_changed_too(copy: Path) -> None:
    fingerprint = verify_release(copy, workers=1).fingerprint
    (copy / "notes.txt").write_text("mine")
    write_manifest(copy)
    assert not found(copy)
    result = verify_release(copy, fingerprint=fingerprint.upper(), workers=1)
    assert [(one.kind, one.path) for one in result.findings] == [("changed", "manifest.json")]


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document["episodes"][0].update(digest="0" * 64),
        lambda document: document["episodes"][0].update(id="0190a1b2-4c5d-7e8f-9a0b-1c2d3e4f5001"),
        lambda document: document["episodes"].pop(0),
    ],
)
def test_a_manifest_that_contradicts_the_episodes(
    copy: Path, change: Callable[[dict[str, list[dict[str, str]]]], None]
) -> None:
    path = an_episode(copy).relative_to(copy).as_posix()
    edited(copy, change)
    assert ("structure", path) in found(copy)


def test_a_manifest_that_leads_out(copy: Path) -> None:
    edited(copy, lambda document: document["files"][0].update(path="../secret"))
    assert found(copy) == [("unreadable", "manifest.json")]


def test_a_catalog_of_something_else(copy: Path) -> None:
    rows = build_catalog(copy)[0].to_pylist()
    rows[0]["digest"] = "0" * 64
    write_catalog(copy, rows_to_table(rows[:2]))
    write_manifest(copy)
    kinds = found(copy)
    assert kinds == [("structure", "catalog.parquet")] * 2


def test_a_split_that_leaks(copy: Path, source: Path, tmp_path: Path, release: Release) -> None:
    document = {
        "format": "exumi-split",
        "version": "1.0",
        "name": "a",
        "level": "episode",
        "lists": {"x": ["0190a1b2-4c5d-7e8f-9a0b-1c2d3e4f5001"]},
    }
    document["lists"] = {**document["lists"], "y": document["lists"]["x"]}  # type: ignore[dict-item, index]  # JSON
    (copy / "splits").mkdir()
    (copy / "splits" / "a.json").write_text(json.dumps(document))
    dataset = json.loads((copy / "dataset.json").read_text())
    (copy / "dataset.json").write_text(json.dumps({**dataset, "splits": ["a"]}))
    write_manifest(copy)
    assert found(copy) == [("structure", "splits/a.json")] * 2


def test_folders_are_released_data_too(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "folders")
    write_manifest(root)
    assert not found(root)
    edited(root, lambda document: document["episodes"][0].update(digest="0" * 64))
    assert [kind for kind, _ in found(root)] == ["structure", "structure"]
    shard = next(root.rglob("streams/width/data/c/0"))
    flip(shard, 3)
    assert ("changed", shard.relative_to(root).as_posix()) in found(root)


class _Killed:
    """Stops a verification after so many bytes."""

    def __init__(self, error: type[BaseException]) -> None:
        self.error = error
        self.calls = 0

    def __call__(self, done: int, total: int) -> None:
        self.calls += 1
        if self.calls == 4:
            raise self.error


@pytest.mark.parametrize("error", [KeyboardInterrupt, Stopped])
def test_one_that_was_stopped_goes_on(copy: Path, error: type[BaseException]) -> None:
    with pytest.raises(error):
        verify_release(copy, workers=1, on_progress=_Killed(error))
    assert len(list(state_folder().iterdir())) == 1
    result = verify_release(copy, workers=1)
    assert (result.good, result.resumed) == (True, 3)
    # It came to its end: the next one reads all again.
    assert not list(state_folder().iterdir())
    assert verify_release(copy, workers=1).resumed == 0


def test_what_was_touched_since_is_read_again(copy: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        verify_release(copy, workers=1, on_progress=_Killed(KeyboardInterrupt))
    read = [json.loads(line)["path"] for line in _lines()]
    flip(copy / read[0], 5)
    result = verify_release(copy, workers=1)
    assert result.resumed == 2
    assert ("changed", read[0]) in [(one.kind, one.path) for one in result.findings]


def test_a_date_that_was_set_back_hides_no_change(copy: Path) -> None:
    import os

    with pytest.raises(KeyboardInterrupt):
        verify_release(copy, workers=1, on_progress=_Killed(KeyboardInterrupt))
    first, second = [json.loads(line)["path"] for line in _lines()][:2]
    for path in (first, second):
        known = (copy / path).stat()
        if path == second:  # another file that takes its name
            (copy / "new").write_bytes((copy / path).read_bytes())
            (copy / "new").replace(copy / path)
        flip(copy / path, 5)
        os.utime(copy / path, ns=(known.st_atime_ns, known.st_mtime_ns))
    found = {one.path for one in verify_release(copy, workers=1).findings if one.kind == "changed"}
    assert found == {first, second}


@pytest.mark.parametrize("line", ['{"path": ["a"], "stamp": [1]}', '{"stamp": 1}', "[]", "7"])
def test_a_line_of_the_state_that_nobody_wrote_is_passed_over(copy: Path, line: str) -> None:
    with pytest.raises(KeyboardInterrupt):
        verify_release(copy, workers=1, on_progress=_Killed(KeyboardInterrupt))
    (path,) = state_folder().iterdir()
    path.write_text(f"{line}\n{path.read_text()}")
    result = verify_release(copy, workers=1)
    assert (result.good, result.resumed) == (True, 3)


def _lines() -> list[str]:
    (path,) = state_folder().iterdir()
    return [line for line in path.read_text().splitlines() if line]


def test_a_state_that_is_cut_or_old_is_no_harm(copy: Path) -> None:
    import os

    with pytest.raises(KeyboardInterrupt):
        verify_release(copy, workers=1, on_progress=_Killed(KeyboardInterrupt))
    (path,) = state_folder().iterdir()
    path.write_text(path.read_text()[:-9])
    with VerifyState(path) as state:
        known = [one for one in tree(copy) if state.get(copy, one)]
    assert len(known) == 2
    with pytest.raises(KeyboardInterrupt):
        verify_release(copy, workers=1, on_progress=_Killed(KeyboardInterrupt))
    (path,) = state_folder().iterdir()
    os.utime(path, (1e9, 1e9))
    assert verify_release(copy, workers=1).resumed == 0


def test_where_nothing_can_be_remembered(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("EXUMI_CACHE", str(tmp_path / "file"))
    assert verify_release(copy, workers=1).good


def test_no_release(tmp_path: Path, source: Path) -> None:
    with pytest.raises(NotAnEpisodeError):
        verify_release(tmp_path)
    with pytest.raises(UsageError, match="no manifest"):
        verify_release(source)


def test_damaged_manifest(copy: Path) -> None:
    shutil.copy(copy / "LICENSE", copy / "manifest.json")
    result: Verification = verify_release(copy)
    assert [one.kind for one in result.findings] == ["unreadable"]
    assert result.to_json()["good"] is False
