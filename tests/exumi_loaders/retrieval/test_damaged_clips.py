"""Damaged clips stop a build, or are left out, counted and named."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import exumi_data
from exumi_data.cli.app import app
from exumi_data.demo import TouchSettings, write_touch_dataset
from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_loaders import Clips, TactileIndex, TextureEncoder, encode_clips

FRAME, REFERENCE, SELECTION = 1, 3, 5  # episodes, by what is damaged in them


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("touches") / "touches"
    write_touch_dataset(root, TouchSettings(parts=4, clips=2), workers=1)
    return root


@pytest.fixture
def touches(sound: Path, tmp_path: Path) -> exumi_data.Dataset:
    opened = exumi_data.open(shutil.copytree(sound, tmp_path / "touches"))
    assert isinstance(opened, exumi_data.Dataset)
    return opened


@pytest.fixture
def damaged(touches: exumi_data.Dataset) -> exumi_data.Dataset:
    with touches[FRAME] as opened:
        start = int(np.asarray(opened["tactile"]._frame_source.offset)[frame_of(touches)])  # type: ignore[attr-defined]
    with Path(touches.episode_location(FRAME), "streams/tactile/data/c/0").open("r+b") as file:
        file.seek(start + 20)
        file.write(b"\xff" * 8)
    shutil.rmtree(Path(touches.episode_location(REFERENCE), "streams/tactile/reference"))
    shutil.rmtree(Path(touches.episode_location(SELECTION), "derived/tactile/salient/c"))
    return touches


def frame_of(dataset: exumi_data.Dataset) -> int:
    """The frame that is spoiled: the third that an encoder sees."""
    return int(Clips(dataset).salient(FRAME).numbers[2])


def test_by_default_the_first_stops_the_build(damaged: exumi_data.Dataset, tmp_path: Path) -> None:
    with pytest.raises(DamagedDataError) as caught:
        TactileIndex.build(damaged, path=tmp_path / "index")
    where = f"{damaged.episode_location(FRAME)}, stream tactile, frame {frame_of(damaged)}"
    assert caught.value.where == where
    assert not (tmp_path / "index").exists()
    with pytest.raises(UsageError, match="'raise', 'skip'"):
        TactileIndex.build(damaged, path=tmp_path / "index", on_corrupt="ignore")  # type: ignore[arg-type]  # on purpose


@pytest.mark.parametrize("workers", [1, 2])
def test_damaged_clips_are_left_out_and_named(
    damaged: exumi_data.Dataset, tmp_path: Path, workers: int
) -> None:
    told: list[Any] = []
    done: list[tuple[int, int]] = []
    index = TactileIndex.build(
        damaged,
        path=tmp_path / "index",
        on_corrupt="skip",
        on_damaged=told.append,
        on_done=lambda *counts: done.append(counts),
        workers=workers,
    )
    assert [(one.episode, one.stream, one.frame) for one in told] == [
        (damaged.ids[FRAME], "tactile", frame_of(damaged)),
        (damaged.ids[REFERENCE], "tactile", None),
        (damaged.ids[SELECTION], "tactile", None),
    ]
    assert "reference" in str(told[1])
    assert "salient" in str(told[2])
    assert done[-1] == (8, 8)
    sound = [number for number in range(8) if number not in (FRAME, REFERENCE, SELECTION)]
    assert [e.id for e in index.entries()] == [f"{damaged.ids[n]}/tactile" for n in sound]
    about = TactileIndex.open(index.path).info()
    assert (about.entries, about.damaged) == (5, 3)
    # What is left is encoded as it would be alone.
    alone = encode_clips(damaged.select([damaged.ids[n] for n in sound]), TextureEncoder(3))
    every = encode_clips(damaged, TextureEncoder(3), on_corrupt="skip")
    np.testing.assert_array_equal(every.vectors, alone.vectors)
    assert (len(every.damaged), len(alone.damaged)) == (3, 0)
    assert repr(every) == f"<EncodedClips: 5 of {TextureEncoder(3).digest}, 3 damaged>"


def test_an_episode_that_changes_is_an_error_in_any_case(touches: exumi_data.Dataset) -> None:
    here, there = (Path(touches.episode_location(number)) for number in (5, 6))

    class Meddling(TextureEncoder):
        def encode(self, *arguments: Any, **named: Any) -> np.ndarray:
            if here.exists():
                shutil.rmtree(here)
                shutil.copytree(there, here)
            return super().encode(*arguments, **named)

    with pytest.raises(ChangedDataError):
        encode_clips(touches, Meddling(3), on_corrupt="skip")


def test_an_index_of_nothing_is_not_built(touches: exumi_data.Dataset, tmp_path: Path) -> None:
    for number in range(len(touches)):
        Path(touches.episode_location(number), "streams/tactile/data/c/0").unlink()
    with pytest.raises(DamagedDataError, match="all 8 clips are damaged"):
        TactileIndex.build(touches, path=tmp_path / "index", on_corrupt="skip")
    assert not list(tmp_path.glob("*index*"))


def test_the_command_names_all_and_exits_with_1(
    damaged: exumi_data.Dataset, tmp_path: Path
) -> None:
    def run(*words: object) -> Any:
        return CliRunner().invoke(app, ["index", *map(str, words)])

    done = run("build", damaged.path, tmp_path / "index", "--workers", 1, "--format", "json")
    assert done.exit_code == 1
    assert "3 clip(s) are damaged and were left out" in done.stderr
    named = f"{damaged.ids[FRAME]}.zarr, stream tactile, frame {frame_of(damaged)}: "
    assert named in done.stderr
    said = json.loads(done.stdout)
    assert (said["entries"], said["damaged"]) == (5, 3)
    assert [clip["frame"] for clip in said["damaged_clips"]] == [frame_of(damaged), None, None]
    assert "3 damaged clips left out" in run("info", tmp_path / "index").stdout
    done = run("build", damaged.path, tmp_path / "more", "--workers", 1, "--keep-going")
    assert done.exit_code == 0
    assert named in done.stderr
    scored = ("eval", tmp_path / "index", damaged.path, "--leave-one-out", "--workers", 1)
    done = run(*scored)
    assert done.exit_code == 1
    assert "first (95 %)" in done.stdout
    assert named in done.stderr
    assert run(*scored, "--keep-going").exit_code == 0


def test_the_command_verifies_an_index(touches: exumi_data.Dataset, tmp_path: Path) -> None:
    index = TactileIndex.build(touches, path=tmp_path / "index").path

    def verify(*words: str) -> Any:
        return CliRunner().invoke(app, ["index", "info", str(index), "--verify", *words])

    assert verify().exit_code == 0
    assert "verified" in verify().stdout
    assert json.loads(verify("--format", "json").stdout)["damaged_files"] == []
    (file,) = index.glob("segments/*/embeddings/c/0/0")
    content = bytearray(file.read_bytes())
    content[100] ^= 0x10
    file.write_bytes(content)
    done = verify("--format", "json")
    assert done.exit_code == 1
    assert "1 file(s) are damaged" in done.stderr
    (one,) = json.loads(done.stdout)["damaged_files"]
    assert one == {"where": str(file), "reason": "vectors have a wrong checksum"}
