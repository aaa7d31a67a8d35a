"""Ids and digests depend on the source and the settings, and on nothing else."""

import hashlib
import uuid
from pathlib import Path

import pytest

from exumi_converters.converter import SourceFile
from exumi_converters.identity import (
    digest_inputs,
    episode_id,
    settings_digest,
    source_digest,
)
from exumi_data.errors import SourceError
from exumi_data.model import CONVENTION_UUID


def test_ids_are_uuids_of_scheme_source_and_key() -> None:
    made = episode_id("octopi/1", "ab" * 32, "egg_0.mov")
    assert uuid.UUID(made).version == 5
    expected = uuid.uuid5(uuid.UUID(CONVENTION_UUID), f"octopi/1\n{'ab' * 32}\negg_0.mov")
    assert made == str(expected)
    others = {
        episode_id("octopi/2", "ab" * 32, "egg_0.mov"),
        episode_id("octopi/1", "cd" * 32, "egg_0.mov"),
        episode_id("octopi/1", "ab" * 32, "egg_1.mov"),
    }
    assert len(others | {made}) == 4


def test_settings_are_digested_whatever_their_order() -> None:
    settings = {"a": 1, "b": [1.5, None]}
    assert settings_digest(settings) == settings_digest(dict(reversed(settings.items())))
    assert settings_digest({"a": 1}) != settings_digest({"a": "1"})
    with pytest.raises(ValueError, match="not JSON compliant"):
        settings_digest({"a": float("nan")})


def test_inputs_are_digested_by_content(tmp_path: Path) -> None:
    (tmp_path / "video").write_bytes(b"video")
    (tmp_path / "table").write_bytes(b"table")
    files = (
        SourceFile(tmp_path / "video", "a/video"),
        SourceFile(tmp_path / "table", "a/table", identifies=False),
    )
    inputs = digest_inputs(files)
    assert [(i.name, i.bytes) for i in inputs] == [("a/video", 5), ("a/table", 5)]
    assert inputs[0].sha256 == hashlib.sha256(b"video").hexdigest()
    assert source_digest(files, inputs) == inputs[0].sha256


def test_a_folder_is_digested_by_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "2.jpg").write_bytes(b"two")
    (folder / "1.jpg").write_bytes(b"one")
    (item,) = digest_inputs((SourceFile(folder, "s/frames"),))
    lines = "".join(
        f"{hashlib.sha256(content).hexdigest()} {len(content)} {name}\n"
        for name, content in (("1.jpg", b"one"), ("2.jpg", b"two"))
    )
    assert (item.name, item.bytes) == ("s/frames/", 6)
    assert item.sha256 == hashlib.sha256(lines.encode()).hexdigest()


def test_a_file_that_has_gone_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"gone\.mov: cannot be read"):
        digest_inputs((SourceFile(tmp_path / "gone.mov", "gone.mov"),))
