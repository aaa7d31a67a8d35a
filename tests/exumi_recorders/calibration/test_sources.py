"""Digests of what calibrations are made from."""

import hashlib
from pathlib import Path

from exumi_data.episode import open_episode
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack
from exumi_recorders.calibration.sources import digest_of_sources
from tests.exumi_data.builders import add_images, metadata


def test_files_folders_and_several(tmp_path: Path) -> None:
    file = tmp_path / "readings.csv"
    file.write_text("opening_mm,count\n")
    of_file = hashlib.sha256(file.read_bytes()).hexdigest()
    assert digest_of_sources([]) is None
    assert digest_of_sources([file]) == of_file
    folder = tmp_path / "maps"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep/b").write_text("b")
    (folder / "a").write_text("a")
    lines = [f"{hashlib.sha256(each.encode()).hexdigest()} " for each in "ab"]
    expected = hashlib.sha256(f"{lines[0]}a\n{lines[1]}deep/b\n".encode()).hexdigest()
    assert digest_of_sources([folder]) == expected
    both = hashlib.sha256(f"{of_file}\n{expected}\n".encode()).hexdigest()
    assert digest_of_sources([file, folder]) == both


def test_an_episode_has_one_however_it_is_packed(tmp_path: Path) -> None:
    path = tmp_path / "e.zarr"
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        add_images(writer)
    with open_episode(path) as episode:
        expected = episode.digest()
    packed = pack(path, tmp_path / "e.zarr.zip")
    assert digest_of_sources([path]) == digest_of_sources([packed]) == expected
