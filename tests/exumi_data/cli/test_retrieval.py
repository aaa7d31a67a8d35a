"""``exumi index build | query | teach | forget | info | eval``, as users call them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from exumi_data.catalog import read_catalog
from exumi_data.cli.app import app
from tests.exumi_loaders.retrieval.gratings import grating_id, write_gratings


def run(*arguments: object) -> Result:
    done = CliRunner().invoke(app, ["index", *map(str, arguments)])
    assert "Traceback" not in done.output
    return done


def result_of(*arguments: object) -> Any:
    done = run(*arguments, "--format", "json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def gratings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gratings(tmp_path_factory.mktemp("gratings") / "gratings")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, gratings: Path) -> Path:
    path = tmp_path_factory.mktemp("index") / "index"
    about = result_of("build", gratings, path, "--split", "mine/train", "--workers", 1)
    assert (about["entries"], about["split"]) == (12, "mine/train")
    return path


@pytest.fixture
def index(tmp_path: Path, built: Path) -> Path:
    return shutil.copytree(built, tmp_path / "index")


def test_without_a_verb_the_catalog_is_written(tmp_path: Path, gratings: Path) -> None:
    copy = shutil.copytree(gratings, tmp_path / "copy")
    for arguments in ((copy,), ("--all", copy), ("catalog", copy)):
        (copy / "catalog.parquet").unlink()
        done = run(*arguments)
        assert done.exit_code == 0, done.output
        assert "18 episodes (18 added)" in done.stdout
        assert read_catalog(copy) is not None
    assert run().exit_code == 2
    assert "catalog" in run("--help").stdout


def test_clips_are_queried_by_episode_and_by_part(index: Path, gratings: Path) -> None:
    done = run("query", index, gratings, "--part", "part_4", "-k", 1)
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    for line in lines:
        assert "Most similar objects (in order of decreasing similarity): a comb 2" in line
    assert "2 of 3 clips are in the index" in done.stderr
    (by_id,) = result_of(
        "query", index, gratings, "--episode", grating_id(4, 0), "--ranking", "matches"
    )
    assert (by_id["in_index"], by_id["ranking"]) == (False, "matches")
    assert "number of matches" in by_id["line"]
    best = by_id["matches"][0]
    assert (best["name"], best["adjectives"][0]) == ("a comb 2", "ribbed")
    assert result_of("query", index, gratings, "--episode", 0, "--unique", "clip", "-k", 9)


def test_teaching_and_forgetting(index: Path, gratings: Path) -> None:
    name = "a comb [new]"
    taught = result_of(
        *("teach", index, gratings, "--part", "part_4", "--name", name),
        *("--adjective", "odd", "--label", "hardness=3", "--by", "model"),
    )
    assert taught["clips"] == 3
    assert "13 entries" in run("info", index).stdout
    (found, *_) = result_of("query", index, gratings, "--episode", grating_id(4, 0))
    assert found["in_index"]
    match = next(match for match in found["matches"] if match["name"] == name)
    assert (match["provenance"], match["labels"]) == ("model", {"hardness": 3.0})
    done = run("forget", index, name)
    assert (done.exit_code, done.stdout) == (0, f"{index}: forgot 1 of {name}\n")
    again = run("forget", index, name)
    assert again.exit_code == 2
    assert "nothing was taught" in again.stderr
    assert result_of("info", index)["entries"] == 12


def test_eval_scores_and_refuses(index: Path, gratings: Path) -> None:
    done = run("eval", index, gratings, "--split", "mine/test", "--workers", 1)
    assert done.exit_code == 0, done.output
    header, first, *_ = done.stdout.splitlines()
    assert "in first five" in header
    assert first.split()[:4] == ["part", "similarity", "6", "6"]
    refused = run("eval", index, gratings, "--workers", 1)
    assert refused.exit_code == 2
    assert "holds 12 of 18 queries" in refused.stderr
    assert "--leave-one-out" in refused.stderr
    scores = result_of("eval", index, gratings, "--leave-one-out", "--workers", 1)
    assert (scores[0]["queries"], scores[0]["by"]) == (18, "part")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("query", "{index}", "{data}"), "--episode or --part"),
        (("query", "{index}", "{data}", "--episode", "99"), "no episode number 99"),
        (("query", "{index}", "{data}", "--episode", "nobody"), "no episode 'nobody'"),
        (("query", "{index}", "{data}", "--part", "nothing"), "no episode of part nothing"),
        (("query", "{data}", "{data}", "--episode", "0"), "no index.json"),
        (("build", "{data}", "{index}"), "there already"),
        (("build", "{data}", "new", "--split", "mine/none"), "no list 'none'"),
        (("build", "nowhere", "new"), "no such file"),
        (
            ("teach", "{index}", "{data}", "--part", "part_1", "--name", "x", "--label", "soft"),
            "not like hardness=7",
        ),
        (("forget", "{index}"), "one of the two"),
        (("forget", "{index}", ""), "nothing was taught as ''"),
        (("teach", "{index}", "{data}", "--episode", "0", "--name", ""), "needs a name"),
        (
            ("teach", "{index}", "{data}", "--episode", "0", "--name", "x", "--label", "=3"),
            "'=3' is not like hardness=7",
        ),
        (
            (
                *("teach", "{index}", "{data}", "--episode", "0", "--name", "x"),
                *("--label", "soft=3", "--label", "soft=4"),
            ),
            "gives 'soft' twice",
        ),
        (
            ("teach", "{index}", "{data}", "--episode", "0", "--name", "x", "--label", "soft=nan"),
            "from 0 to 10",
        ),
        (("build", "{data}", "new", "--frames", "99999999999"), "from 1 to 4096"),
        (("build", "{data}", "{index}/index"), "lies inside"),
    ],
)
def test_mistakes_are_said_in_one_line(
    index: Path,
    gratings: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run(*(word.format(index=index, data=gratings) for word in arguments))
    assert done.exit_code == 2
    assert said in done.stderr.replace("\n", " ")
    assert not (tmp_path / "new").exists()


def test_names_cannot_command_a_terminal(index: Path, gratings: Path) -> None:
    name = "a \x1b[31mball\nmy-index: forgot 9 of everything"
    taught = run("teach", index, gratings, "--episode", grating_id(4, 0), "--name", name)
    assert taught.exit_code == 0
    asked = run("query", index, gratings, "--episode", grating_id(4, 0), "-k", 1)
    document = json.loads((index / "index.json").read_text())
    document["source"]["name"] = name
    (index / "index.json").write_text(json.dumps(document))
    told = run("info", index)
    forgotten = run("forget", index, name)
    for done, lines in ((taught, 1), (asked, 1), (told, 4), (forgotten, 1)):
        assert "\\x1b[31mball\\nmy-index" in done.stdout
        assert "\x1b" not in done.stdout
        assert len(done.stdout.splitlines()) == lines


def test_every_verb_shows_examples() -> None:
    for verb in ("build", "query", "teach", "forget", "info", "eval", "catalog"):
        done = run(verb, "--help")
        assert done.exit_code == 0
        assert f"exumi index {verb if verb != 'catalog' else ''}".strip() in done.stdout
        assert "Examples:" in done.stdout


def test_it_needs_no_torch(
    index: Path, gratings: Path, exumi: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "torch.py").write_text("raise ModuleNotFoundError('none', name='torch')")
    import os

    path = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", "")))
    done = exumi("index", "query", index, gratings, "--episode", 0, PYTHONPATH=path)
    assert done.returncode == 0, done.stderr
    assert "Most similar objects" in done.stdout
