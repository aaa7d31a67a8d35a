"""One front door: a dataset, an episode, or one clear error."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import exumi_data
from exumi_data.errors import (
    DamagedDataError,
    MetadataError,
    NotAnEpisodeError,
    UnsupportedError,
)
from exumi_data.store.pack import pack
from tests.exumi_data.builders import (
    edit_json,
    edit_metadata,
    episode_id,
    write_dataset,
    write_small,
)


def test_an_episode_a_zip_and_a_dataset(tmp_path: Path) -> None:
    path = write_small(tmp_path / "a.zarr")
    dataset = write_dataset(tmp_path / "ds")
    for episode in (path, pack(path), str(path), f"{path}/", os.fsencode(path)):
        opened = exumi_data.open(episode)  # type: ignore[arg-type]  # bytes are paths too
        assert isinstance(opened, exumi_data.Episode)
        assert opened.id == episode_id()
    for root in (dataset, f"{dataset}/", str(dataset)):
        assert isinstance(exumi_data.open(root), exumi_data.Dataset)


def test_a_packed_episode_is_never_a_dataset(tmp_path: Path) -> None:
    path = write_small(tmp_path / "a.zarr")
    (path / "dataset.json").write_text("{}")
    assert isinstance(exumi_data.open(pack(path)), exumi_data.Episode)


def test_an_episode_of_another_name(tmp_path: Path) -> None:
    path = write_small(tmp_path / "a.zarr")
    path.rename(tmp_path / "other")
    assert isinstance(exumi_data.open(tmp_path / "other"), exumi_data.Episode)


def empty(_: Path) -> str:
    return ""


def missing(root: Path) -> Path:
    return root / "missing.zarr"


def below_a_file(root: Path) -> Path:
    (root / "file").write_text("x")
    return root / "file" / "a.zarr"


def long_name(root: Path) -> Path:
    return root / ("a" * 300)


def nul(root: Path) -> str:
    return f"{root}/a\0b"


def empty_folder(root: Path) -> Path:
    return root


def text_file(root: Path) -> Path:
    (root / "readme.txt").write_text("hello")
    return root / "readme.txt"


def video(root: Path) -> Path:
    (root / "clip.mp4").write_bytes(b"\0\0\0\x20ftypisom" + bytes(100))
    return root / "clip.mp4"


def empty_file(root: Path) -> Path:
    (root / "a.zarr.zip").write_bytes(b"")
    return root / "a.zarr.zip"


def pipe(root: Path) -> Path:
    os.mkfifo(root / "a.zarr")
    return root / "a.zarr"


def device(_: Path) -> str:
    return os.devnull


def dangling_link(root: Path) -> Path:
    (root / "a.zarr").symlink_to(root / "nowhere")
    return root / "a.zarr"


def link_to_itself(root: Path) -> Path:
    (root / "a.zarr").symlink_to(root / "a.zarr")
    return root / "a.zarr"


def unfinished(root: Path) -> Path:
    (write_small(root / "a.zarr") / "zarr.json").unlink()
    return root / "a.zarr"


def partial(root: Path) -> Path:
    return write_small(root / "a.zarr").rename(root / f".partial-{episode_id()}")


def plain_zarr(root: Path) -> Path:
    (root / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    return root


def zarr_array(root: Path) -> Path:
    return write_small(root / "a.zarr") / "streams" / "width" / "time"


def newer_episode(root: Path) -> Path:
    path = write_small(root / "a.zarr")
    edit_metadata(path, lambda document: document.update(version="2.0"))
    return path


def newer_zip(root: Path) -> Path:
    return pack(newer_episode(root))


def broken_json(root: Path) -> Path:
    (write_small(root / "a.zarr") / "zarr.json").write_text("{")
    return root / "a.zarr"


def newer_dataset(root: Path) -> Path:
    write_dataset(root / "ds", 1)
    edit_json(root / "ds" / "dataset.json", lambda document: document.update(version="3.1"))
    return root / "ds"


def broken_dataset(root: Path) -> Path:
    (root / "dataset.json").write_bytes(b"\xff")
    return root


def dataset_that_is_an_episode(root: Path) -> Path:
    write_dataset(root / "ds", 1)
    edit_json(root / "ds" / "dataset.json", lambda document: document.update(format="other"))
    return root / "ds"


def cut_short(root: Path) -> Path:
    packed = pack(write_small(root / "a.zarr"))
    packed.write_bytes(packed.read_bytes()[:-30])
    return packed


def other_zip(root: Path) -> Path:
    import zipfile

    with zipfile.ZipFile(root / "other.zip", "w") as archive:
        archive.writestr("a.txt", "hello")
    return root / "other.zip"


WRONG: dict[Any, tuple[type[Exception], str]] = {
    empty: (NotAnEpisodeError, "empty path was given"),
    missing: (NotAnEpisodeError, "no such file or folder"),
    below_a_file: (NotAnEpisodeError, "no such file or folder"),
    long_name: (NotAnEpisodeError, "cannot be opened|no such file"),
    nul: (NotAnEpisodeError, "no such file or folder"),
    empty_folder: (NotAnEpisodeError, "neither a dataset .* nor an episode"),
    text_file: (NotAnEpisodeError, "neither an episode's folder nor a packed episode"),
    video: (NotAnEpisodeError, "neither an episode's folder nor a packed episode"),
    empty_file: (NotAnEpisodeError, "neither an episode's folder nor a packed episode"),
    pipe: (NotAnEpisodeError, "no such file or folder"),
    device: (NotAnEpisodeError, "no such file or folder"),
    dangling_link: (NotAnEpisodeError, "no such file or folder"),
    link_to_itself: (NotAnEpisodeError, "no such file or folder|cannot be opened"),
    unfinished: (NotAnEpisodeError, "one that was never finished"),
    partial: (DamagedDataError, "never finished"),
    plain_zarr: (MetadataError, "not an exUMI Episode"),
    zarr_array: (MetadataError, "not an exUMI Episode"),
    newer_episode: (UnsupportedError, "version 2.0 is newer"),
    newer_zip: (UnsupportedError, "version 2.0 is newer"),
    broken_json: (MetadataError, "not valid JSON"),
    newer_dataset: (UnsupportedError, "version 3.1 is newer"),
    broken_dataset: (MetadataError, "not valid JSON"),
    dataset_that_is_an_episode: (MetadataError, "expected format 'exumi-dataset'"),
    cut_short: (DamagedDataError, "not a readable zip"),
    other_zip: (NotAnEpisodeError, r"no zarr\.json"),
}


@pytest.mark.parametrize("make", WRONG, ids=lambda make: make.__name__)
def test_anything_else_is_one_clear_error(tmp_path: Path, make: Any) -> None:
    error, message = WRONG[make]
    path = make(tmp_path)
    with pytest.raises(error, match=message) as caught:
        exumi_data.open(path)
    assert str(path).rstrip("/") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("url", ["ftp://host/a.zarr.zip", "file:///a.zarr"])
def test_urls_of_other_kinds_are_refused(url: str) -> None:
    with pytest.raises(UnsupportedError, match="no kind of URL"):
        exumi_data.open(url)


def test_a_folder_that_may_not_be_read(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may read everything")
    path = write_small(tmp_path / "a.zarr")
    for inside in (path / "zarr.json", path):
        inside.chmod(0)
        try:
            with pytest.raises(exumi_data.ExumiError, match="Permission denied"):
                exumi_data.open(path)
        finally:
            inside.chmod(0o755)


def test_metadata_is_read_without_heavy_libraries(tmp_path: Path) -> None:
    path = write_small(tmp_path / "a.zarr")
    script = """
import sys, exumi_data
assert exumi_data.open(sys.argv[1]).metadata.task.name == "press"
heavy = {"zarr", "numcodecs", "pyarrow", "scipy", "cv2", "av", "torch", "simplejpeg"}
assert not heavy & sys.modules.keys(), heavy & sys.modules.keys()
"""
    command = [sys.executable, "-c", script, str(path)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
