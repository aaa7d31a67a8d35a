"""Every bad path gives one clear message, exit code 2, and no traceback."""

import json
import os
import shutil
import stat
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from exumi_data.cli.app import app
from exumi_data.cli.failures import reported
from exumi_data.store.pack import pack
from tests.exumi_data.builders import edit_json, edit_metadata

Program = Callable[..., subprocess.CompletedProcess[str]]

READERS = ("stats", "info", "validate", "pack", "index")


@pytest.fixture
def exumi() -> Program:
    """Run the program within this process, which is faster than many processes."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        given = [str(argument) for argument in arguments]
        done = CliRunner().invoke(app, given)
        return subprocess.CompletedProcess(given, done.exit_code, done.stdout, done.stderr)

    return run


def refused(done: subprocess.CompletedProcess[str]) -> str:
    """Check that a run was refused in good manner; return what it said."""
    assert done.returncode == 2, done
    assert done.stdout == ""
    assert done.stderr.startswith("error: ")
    assert "Traceback" not in done.stderr
    assert "unexpected" not in done.stderr
    assert 1 <= len(done.stderr.splitlines()) <= 2
    return done.stderr


@pytest.mark.parametrize("verb", READERS)
def test_a_path_that_is_not_there(exumi: Program, tmp_path: Path, verb: str) -> None:
    assert "nowhere" in refused(exumi(verb, tmp_path / "nowhere"))


@pytest.mark.parametrize("verb", READERS)
def test_a_folder_that_holds_something_else(exumi: Program, tmp_path: Path, verb: str) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    assert str(tmp_path) in refused(exumi(verb, tmp_path))


@pytest.mark.parametrize("verb", READERS)
def test_a_file_that_is_something_else(exumi: Program, tmp_path: Path, verb: str) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("hello")
    assert "notes.txt" in refused(exumi(verb, path))


@pytest.mark.parametrize("verb", ["stats", "info", "pack"])
def test_an_episode_that_was_never_finished(exumi: Program, episode: Path, verb: str) -> None:
    partial = episode.with_name(".partial-0190a1b2-4c5d-7e8f-9a0b-1c2d3e4f5001")
    episode.rename(partial)
    said = refused(exumi(verb, partial))
    assert "never finished" in said
    (partial / "zarr.json").unlink()
    half = partial.rename(partial.with_name("half.zarr"))
    assert "never finished" in refused(exumi(verb, half))


@pytest.mark.parametrize("verb", ["stats", "info", "pack"])
@pytest.mark.parametrize("size", [0, 100, -100])
def test_a_zip_that_was_cut_short(exumi: Program, episode: Path, verb: str, size: int) -> None:
    packed = pack(episode)
    whole = packed.read_bytes()
    packed.write_bytes(whole[:size])
    said = refused(exumi(verb, packed))
    assert packed.name in said
    assert "copy it again" in said or size == 0


@pytest.mark.parametrize("verb", ["stats", "info", "pack"])
def test_broken_metadata(exumi: Program, episode: Path, verb: str) -> None:
    root = episode / "zarr.json"
    document = json.loads(root.read_text())
    document["attributes"]["exumi"]["regime"] = "dance"
    root.write_text(json.dumps(document))
    assert "regime" in refused(exumi(verb, episode))
    root.write_text("{ not json")
    assert "not valid JSON" in refused(exumi(verb, episode))


def test_a_missing_array(exumi: Program, episode: Path) -> None:
    shutil.rmtree(episode / "streams" / "pose" / "time")
    for verb in ("stats", "pack"):
        assert "missing" in refused(exumi(verb, episode))


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--from", "zoo"], "octopi"),
        ([], "nowhere"),
        (["--from", "octopi"], "nowhere"),
        (["--from", "clips"], "nowhere"),
    ],
)
def test_converting_what_is_not_there(
    exumi: Program, tmp_path: Path, arguments: list[str], word: str
) -> None:
    said = refused(exumi("convert", tmp_path / "nowhere", tmp_path / "out", *arguments))
    assert word in said
    assert not (tmp_path / "out").exists()


def test_converting_into_a_folder_of_something_else(exumi: Program, tmp_path: Path) -> None:
    source, target = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    target.mkdir()
    (source / "a_0.mov").write_bytes(b"")
    (target / "thesis.txt").write_text("precious")
    refused(exumi("convert", source, target, "--from", "clips"))
    assert (target / "thesis.txt").read_text() == "precious"
    assert [path.name for path in target.iterdir()] == ["thesis.txt"]


def test_an_empty_clip_is_named_and_the_exit_code_is_1(exumi: Program, tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    (source / "egg_0.mov").write_bytes(b"no video at all")
    arguments = ["convert", source, tmp_path / "out", "--from", "clips", "--workers", "1"]
    done = exumi(*arguments)
    assert done.returncode == 1
    assert "error: 1 of 1 failed" in done.stderr
    assert "egg_0.mov: " in done.stderr
    assert "Traceback" not in done.stderr
    assert "0 written, 1 failed of 1 episodes" in done.stdout
    assert exumi(*arguments, "--keep-going").returncode == 0
    listed = json.loads(exumi(*arguments, "--format", "json").stdout)
    assert [failure["name"] for failure in listed["failed"]] == ["egg_0.mov"]


def test_options_of_prepare_that_exclude_each_other(
    exumi: Program, dataset: Path, tmp_path: Path
) -> None:
    target = tmp_path / "training"
    done = exumi("prepare", dataset, target, "--lossless", "--quality", "80")
    assert "exclude each other" in refused(done)
    done = exumi("prepare", dataset, target, "--fov", "80")
    assert "--fov goes with --rgb rectify" in refused(done)
    done = exumi("prepare", dataset, target, "--pair-within", "0.1")
    assert "--pair-within goes with --tactile combined" in refused(done)
    assert not target.exists()


def test_a_demonstration_never_overwrites_other_data(
    exumi: Program, dataset: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    dataset.rename(out / "dataset")
    said = refused_after_title(exumi("demo", "--direct", "--out", out, "--seconds", "3"))
    assert "--out" in said
    assert len(list((out / "dataset").glob("episodes/*/*.zarr"))) == 2


def refused_after_title(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert "Traceback" not in done.stderr
    return done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, which is always full")
def test_a_full_disk_is_said_with_what_to_do(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as ended, reported(), Path("/dev/full").open("wb") as full:
        full.write(b"x" * 100_000)
    assert ended.value.exit_code == 2
    assert "Free some space" in capfd.readouterr().err


@pytest.mark.parametrize("verb", READERS)
def test_an_empty_path_is_not_the_current_folder(
    exumi: Program, dataset: Path, verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(dataset)
    assert "an empty path was given" in refused(exumi(verb, ""))


def test_an_empty_path_of_an_option(exumi: Program, dataset: Path) -> None:
    assert "empty path" in refused(exumi("validate", dataset, "--config", ""))


@pytest.mark.parametrize(
    ("part", "whole"),
    [
        ("episodes", "my-dataset"),
        ("episodes/01", "my-dataset"),
        ("dataset.json", "my-dataset"),
        ("catalog.parquet", "my-dataset"),
        ("episodes/01/{episode}.zarr/streams", "{episode}.zarr"),
        ("episodes/01/{episode}.zarr/streams/pose/zarr.json", "{episode}.zarr"),
    ],
)
def test_a_part_of_a_dataset_names_the_whole(
    exumi: Program, dataset: Path, episode: Path, part: str, whole: str
) -> None:
    said = refused(exumi("validate", dataset / part.format(episode=episode.stem)))
    assert said.rstrip().endswith(whole.format(episode=episode.stem))
    assert "convert" not in said


def test_a_part_is_known_from_inside(
    exumi: Program, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(dataset / "episodes")
    for verb in ("validate", "info"):
        assert f"Give all of it: {dataset}" in refused(exumi(verb, "."))


@pytest.mark.parametrize("verb", ["pack", "index"])
def test_urls_are_refused_where_something_is_written(exumi: Program, verb: str) -> None:
    assert "https://example.org/x: this works on local files" in refused(
        exumi(verb, "https://example.org/x")
    )


@pytest.mark.parametrize("verb", ["stats", "info", "validate"])
def test_urls_are_refused_as_they_were_given(exumi: Program, verb: str) -> None:
    said = refused(exumi(verb, "ftp://me:word@example.org/x.zip"))
    assert "ftp://***@example.org/x.zip: ftp:// is no kind of URL" in said


def test_names_cannot_write_to_the_terminal(exumi: Program, tmp_path: Path) -> None:
    said = refused(exumi("validate", tmp_path / "\x1b[31mred\x07"))
    assert r"\x1b[31mred\x07: no such file" in said
    assert "\x1b" not in said


CODE = "\x1b[31mred[bold]"


def painted(values: Any) -> Any:
    """Return metadata in which every text that its maker chose holds codes, and markup."""
    free = {"algorithm", "by", "detail", "instruction", "message", "object_id", "operator", "site"}
    free |= {"tool", "tool_version"}
    if isinstance(values, list):
        return [painted(value) for value in values]
    if not isinstance(values, dict):
        return values
    return {key: CODE if key in free else painted(value) for key, value in values.items()}


def test_metadata_cannot_write_to_the_terminal(
    exumi: Program, dataset: Path, episode: Path
) -> None:
    def paint_dataset(metadata: Any) -> None:
        by = {"tool": CODE, "tool_version": CODE}
        metadata |= {"name": CODE, "description": CODE, "authors": [CODE], "made_by": by}

    def paint_episode(metadata: Any) -> None:
        named = {"task": {"name": CODE, "instruction": CODE}, "operator": CODE, "site": CODE}
        metadata.update({**painted(metadata), **named})

    edit_json(dataset / "dataset.json", paint_dataset)
    edit_metadata(episode, paint_episode)
    (dataset / "catalog.parquet").unlink()
    for verb in ("info", "stats", "validate"):
        for path in (dataset, episode):
            done = exumi(verb, path)
            assert done.returncode == 0, done
            assert "\x1b" not in done.stdout + done.stderr
            if verb == "info":
                assert r"\x1b[31mred[bold]" in done.stdout
            if (verb, path) == ("info", episode):
                assert done.stdout.count(r"\x1b[31mred[bold]") > 8


def test_a_link_that_leads_in_a_circle(exumi: Program, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    assert "no such file or folder" in refused(exumi("validate", tmp_path / "loop"))


def closed(path: Path, mode: int) -> None:
    """Take rights away, where that means anything: whoever may do all has them still."""
    path.chmod(mode)
    right = os.W_OK if mode & stat.S_IRUSR else os.R_OK
    if os.access(path, right):
        path.chmod(0o755)
        pytest.skip("this user may read and write everything")


def test_a_dataset_that_may_not_be_written(exumi: Program, dataset: Path) -> None:
    (dataset / "catalog.parquet").unlink()
    closed(dataset, 0o555)
    for arguments in (("validate", dataset, "--fix", "--apply"), ("index", dataset)):
        said = refused(exumi(*arguments))
        assert said == f"error: {dataset}/catalog.parquet: Permission denied\n"
    dataset.chmod(0o755)


def test_a_catalog_that_may_not_be_read_is_not_replaced(exumi: Program, dataset: Path) -> None:
    catalog = dataset / "catalog.parquet"
    closed(catalog, 0o000)
    done = exumi("validate", dataset, "--fix", "--apply")
    assert "catalog.parquet: not mended\n  catalog.parquet may not be read" in done.stdout
    assert "CAT-001: catalog.parquet cannot be read: Permission denied" in done.stdout
    assert "may not be read" in refused(exumi("index", dataset))
    assert stat.S_IMODE(catalog.stat().st_mode) == 0


def test_what_may_not_be_read_is_not_called_missing(
    exumi: Program, dataset: Path, episode: Path
) -> None:
    closed(episode, 0o000)
    done = exumi("validate", dataset)
    assert done.returncode == 1
    assert done.stdout.splitlines()[0] == f"{dataset}: not fully checked"
    assert "not checked: the folder: Permission denied" in done.stdout
    assert "ROOT-001" not in done.stdout
    episode.chmod(0o755)


def test_a_working_folder_that_is_gone(
    exumi: Program, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert "The folder you work in is no longer there" in refused(exumi("validate", dataset))


def test_a_working_folder_below_one_that_is_closed(
    exumi: Program, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "outer" / "inner").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "outer" / "inner")
    closed(tmp_path / "outer", 0o000)
    done = exumi("validate", dataset)
    (tmp_path / "outer").chmod(0o755)
    assert done.returncode == 0, done.stderr


def test_a_configuration_that_is_a_link(
    exumi: Program, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    (work / "exumi.toml").symlink_to(tmp_path / "lab.toml")
    assert "exumi.toml: no such file" in refused(exumi("validate", dataset))
    (tmp_path / "lab.toml").write_text('[validate.rules]\n"ID-002" = "off"\n')
    done = exumi("validate", dataset)
    assert done.returncode == 0, done.stderr
    assert "ID-002: off" in done.stdout
