"""``exumi stats --html``: a page is written whole or not at all, and says what was found."""

import json
import os
import shutil
import signal
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from exumi_data.cli.app import app
from exumi_data.stats.html.choosing import Job
from exumi_data.stats.html.looking import Looked, look


def run(*arguments: object) -> Result:
    done = CliRunner().invoke(app, ["stats", *(str(argument) for argument in arguments)])
    assert "Traceback" not in done.output
    return done


def test_a_page_with_the_verdict(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    done = run(dataset, "--html", file)
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith(f"{file}: 2 episodes, ")
    page = file.read_text()
    assert "<strong>Valid</strong>" in page
    assert "feel [it]" in page
    assert run(dataset, "--html", file, "--level", "none").exit_code == 0  # in its place
    assert "Not checked" in file.read_text()


def test_the_numbers_are_printed_as_well(dataset: Path, tmp_path: Path) -> None:
    done = run(dataset, "--html", tmp_path / "page.html", "--level", "arrays", "--format", "json")
    assert json.loads(done.stdout)["episodes"] == 2
    assert "up to level arrays" in (tmp_path / "page.html").read_text()


def test_damage_is_the_verdict(dataset: Path, episode: Path, tmp_path: Path) -> None:
    shard = next((episode / "streams" / "tactile" / "data").rglob("c/*"))
    content = bytearray(shard.read_bytes())
    content[700] ^= 0xFF
    shard.write_bytes(content)
    file = tmp_path / "page.html"
    assert run(dataset, "--html", file).exit_code == 0
    page = file.read_text()
    assert "Not valid: " in page
    assert str(tmp_path) not in page


def test_an_episode_that_cannot_be_read(dataset: Path, episode: Path, tmp_path: Path) -> None:
    shutil.rmtree(episode / "streams" / "pose" / "data" / "c")
    file = tmp_path / "page.html"
    done = run(dataset, "--html", file)
    assert done.exit_code == 1
    assert done.stdout.startswith(f"{file}: 1 episode, ")
    assert "1 episode could not be read" in file.read_text()


def test_a_level_is_for_a_page(dataset: Path) -> None:
    assert run(dataset, "--level", "arrays").exit_code == 2


@pytest.mark.parametrize("name", ["my-dataset/page.html", "notes.txt"])
def test_what_is_there_is_not_replaced(dataset: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    done = run(dataset, "--html", tmp_path / name)
    assert done.exit_code == 2
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert not (dataset / "page.html").exists()


def test_interrupted_it_leaves_no_file(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(job: Job) -> Looked:
        os.kill(os.getpid(), signal.SIGINT)
        return look(job)

    monkeypatch.setattr("exumi_data.stats.html.collecting.look", interrupted)
    before = sorted(tmp_path.iterdir())
    done = run(dataset, "--html", tmp_path / "page.html", "--level", "none", "--workers", "1")
    assert done.exit_code == 130
    assert sorted(tmp_path.iterdir()) == before
