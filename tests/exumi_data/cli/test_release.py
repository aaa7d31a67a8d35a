"""``exumi release``: what is told, what is refused, and the exit codes."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from exumi_data.cli.app import app
from exumi_data.dataset import open_dataset
from exumi_data.editing.documents import change_dataset
from exumi_data.model.dataset import DatasetMetadata
from tests.exumi_data.builders import edit_metadata, episode_id, write_dataset


@pytest.fixture
def root(tmp_path: Path) -> Path:
    made = write_dataset(tmp_path / "set")
    (made / "LICENSE").write_text("CC0 1.0 Universal\n")
    return made


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXUMI_CACHE", str(tmp_path / "cache"))


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["release", *map(str, arguments)])


def good(*arguments: object) -> str:
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_a_release(root: Path, tmp_path: Path) -> None:
    text = good(root, tmp_path / "v1", "--split", "episode", "--lists", "train=2,val=1")
    assert "tests 1.0.0, 3 episodes" in text
    assert "split default: train 2, val 1" in text
    fingerprint = text.rpartition("manifest): ")[2].split()[0]
    text = good("verify", tmp_path / "v1", "--fingerprint", fingerprint)
    assert "everything is as released" in text
    assert fingerprint in text


def test_the_long_form(root: Path, tmp_path: Path) -> None:
    document = json.loads(good("build", root, tmp_path / "v1", "--format", "json"))
    assert document["released"]
    assert document["licence"] == "CC0-1.0"
    assert document["preview"]
    assert document["preview_bytes"] < 50_000_000


def test_a_dry_run_writes_nothing(root: Path, tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    text = good(root, tmp_path / "v1", "--dry-run", "--preview-mb", "0.001")
    assert "would be written" in text
    assert "no episode fits into a preview" in text
    assert sorted(tmp_path.rglob("*")) == before


def test_all_problems_at_once(root: Path, tmp_path: Path) -> None:
    (root / "LICENSE").unlink()
    done = run(root, root / "inside", "--version", "1", "--split", "object")
    assert done.exit_code == 2
    for words in ("lies in the dataset", "'1' is no version", "no object_id", "text of the lic"):
        assert words in done.stderr
    done = run(root, tmp_path / "v1", "--lists", "a=1")
    assert done.exit_code == 2
    assert not (tmp_path / "v1").exists()


def test_invalid_data(root: Path, tmp_path: Path) -> None:
    episode = next(root.glob("episodes/*/*.zarr"))
    edit_metadata(episode, lambda metadata: metadata.update(regime="dance"))
    done = run(root, tmp_path / "v1")
    assert done.exit_code == 1
    assert "regime" in done.stderr
    assert not list(tmp_path.glob("*v1*"))


def test_an_episode_without_its_document_hides_no_other_reason(root: Path, tmp_path: Path) -> None:
    episode = next(root.glob("episodes/*/*.zarr"))
    (episode / "zarr.json").unlink()
    done = run(root, tmp_path / "v1", "--version", "1", "--format", "json")
    assert done.exit_code == 1
    document = json.loads(done.stdout)
    assert any("ROOT-001" in error for error in document["errors"])
    told = "\n".join(document["problems"])
    assert f"{episode}: no zarr.json" in told
    assert f"exumi dataset remove {root} --unreadable" in told
    assert "'1' is no version" in told


def test_broken_rules_are_listed(root: Path, tmp_path: Path) -> None:
    (root / "splits").mkdir()
    (root / "splits" / "stray.json").write_text("{}")
    done = run(root, tmp_path / "v1", "--format", "json")
    assert done.exit_code == 1
    assert "SPLIT-002" in done.stderr
    document = json.loads(done.stdout)
    assert not document["released"]
    assert any("SPLIT-002" in error for error in document["errors"])


def test_an_unknown_licence_is_asked_for_on_a_terminal(root: Path, tmp_path: Path) -> None:
    def forget(metadata: DatasetMetadata) -> None:
        metadata.licence = "NOASSERTION"

    change_dataset(root, forget)
    (root / "LICENSE").write_text("mine")
    done = run(root, tmp_path / "v1")
    assert done.exit_code == 2
    assert "NOASSERTION" in done.stderr
    command = [sys.executable, "-m", "exumi_data.cli", "release", str(root), str(tmp_path / "v1")]
    person, terminal = pty.openpty()
    with subprocess.Popen(
        [*command, "--workers", "1"], stdin=terminal, stdout=subprocess.PIPE, stderr=terminal
    ) as program:
        os.close(terminal)
        shown = b""
        while b"Licence of the data" not in shown:
            shown += os.read(person, 1000)
        os.write(person, b"LicenseRef-typed\n")
        assert program.wait(60) == 0
    os.close(person)
    assert open_dataset(tmp_path / "v1").metadata.licence == "LicenseRef-typed"


def test_verify_exit_codes(root: Path, tmp_path: Path) -> None:
    good(root, tmp_path / "v1", "-q")
    (tmp_path / "v1" / "extra.txt").touch()
    done = run("verify", tmp_path / "v1", "--quick", "--format", "json")
    assert done.exit_code == 1
    document = json.loads(done.stdout)
    assert [(one["kind"], one["path"]) for one in document["findings"]] == [("extra", "extra.txt")]
    assert "extra.txt does not belong" in run("verify", tmp_path / "v1").stdout
    assert run("verify", root).exit_code == 2
    assert run("verify", tmp_path / "nothing").exit_code == 2


def test_diff(root: Path, tmp_path: Path) -> None:
    good(root, tmp_path / "v1", "-q")
    assert good("diff", tmp_path / "v1", root) == "3 episodes are the same\nNothing differs.\n"
    rated = CliRunner().invoke(app, ["dataset", "rate", str(root), "--all", "--success"])
    assert rated.exit_code == 0
    text = good("diff", tmp_path / "v1", root)
    assert "3 episodes relabelled, the same samples (success nothing, now true)" in text
    assert text.endswith("This calls for a minor version.\n")
    document = json.loads(good("diff", tmp_path / "v1", root, "--format", "json"))
    assert document["step"] == "minor"
    assert {one["id"] for one in document["episodes"]} == {episode_id(i) for i in range(3)}
    text = good(root, tmp_path / "v2", "--previous", tmp_path / "v1")
    assert "tests 1.1.0" in text
    assert "since 1.0.0:" in text


def test_push_refuses_what_is_damaged(root: Path, tmp_path: Path) -> None:
    good(root, tmp_path / "v1", "-q")
    (tmp_path / "v1" / "LICENSE").write_text("another")
    done = run("push", tmp_path / "v1", "our-lab/set")
    assert done.exit_code == 2
    assert "is not as it was released: LICENSE has another size" in done.stderr


def test_a_name_that_no_repository_has_is_found_before_the_work(root: Path, tmp_path: Path) -> None:
    done = run(root, tmp_path / "v1", "--push", "our lab/set")
    assert done.exit_code == 2
    assert "'our lab/set' is no name of a repository" in done.stderr
    assert not (tmp_path / "v1").exists()
