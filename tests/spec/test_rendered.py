"""What is rendered is what would be rendered now."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from exumi_data.model.schema import DOCUMENTS, json_schema


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *command], check=False, capture_output=True, text=True)


def test_tables_schemas_and_corpus_are_current(spec: Path) -> None:
    done = run(str(spec / "generate.py"), "--check")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_schema_is_that_of_the_model(spec: Path, name: str) -> None:
    path = spec / "schema" / "1.0" / f"{name}.schema.json"
    assert json.loads(path.read_text("utf-8")) == json_schema(name)


def test_defaults_are_in_the_tables(spec: Path) -> None:
    text = (spec / "1.0" / "episode.md").read_text("utf-8")
    for field, default in (("revision", "1"), ("gripper", '"parallel"'), ("drift_ppm", "0.0")):
        (row,) = (line for line in text.splitlines() if line.startswith(f"| `{field}` |"))
        assert f"OPTIONAL, default `{default}`" in row


def test_the_corpus_is_made_anew_byte_by_byte(spec: Path, corpus: Path, tmp_path: Path) -> None:
    generate = str(spec / "conformance" / "generate.py")
    target = tmp_path / "corpus"
    assert run(generate, "--target", str(target)).returncode == 0
    assert run(generate, "--check", "--target", str(target)).returncode == 0
    made = {p.relative_to(target): p.read_bytes() for p in target.rglob("*") if p.is_file()}
    there = {
        path.relative_to(corpus): path.read_bytes()
        for path in corpus.rglob("*")
        if path.is_file() and path.name != "dump.json"
    }
    assert len(made) > 1000
    assert made == there


def test_a_change_is_found(spec: Path, corpus: Path, tmp_path: Path) -> None:
    generate = str(spec / "conformance" / "generate.py")
    target = tmp_path / "corpus"
    shutil.copytree(corpus, target)
    (target / "valid" / "pose__minimal" / "expected.json").write_text("{}")
    (target / "stray").write_text("")
    done = run(generate, "--check", "--target", str(target))
    assert done.returncode == 1
    assert "stray" in done.stderr
    assert "pose__minimal/expected.json" in done.stderr


def test_dumps_are_written_kept_and_checked(spec: Path, corpus: Path, tmp_path: Path) -> None:
    programs = spec / "conformance"
    case = tmp_path / "valid" / "images__encoded"
    shutil.copytree(corpus / "valid" / "images__encoded", case)
    of_case = ("--target", str(tmp_path))
    assert run(str(programs / "make_dumps.py"), "--check", *of_case).returncode == 0
    stored = (case / "dump.json").read_bytes()
    (case / "dump.json").write_bytes(re.sub(rb'"count": (\d)', rb'"count": 1\1', stored, count=1))
    done = run(str(programs / "make_dumps.py"), "--check", *of_case)
    assert done.returncode == 1
    assert "images__encoded/dump.json: $.streams[" in done.stderr
    assert run(str(programs / "make_dumps.py"), *of_case).returncode == 0
    assert (case / "dump.json").read_bytes() == stored
    # What makes the stores leaves the dumps alone.
    assert run(str(programs / "generate.py"), *of_case).returncode == 0
    assert (case / "dump.json").read_bytes() == stored
