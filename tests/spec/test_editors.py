"""What an editor must not lose: the harness accepts ours, and finds those that lose something."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from exumi_validators import validate
from tests.spec.test_harnesses import CONFORMANCE, VALIDATOR, differences, only, program, run

EDITOR = CONFORMANCE / "adapters" / "exumi_editor.py"
SPOILED = """
import importlib.util, sys
spec = importlib.util.spec_from_file_location("adapter", sys.argv.pop(1))
adapter = importlib.util.module_from_spec(spec)
spec.loader.exec_module(adapter)
{change}
sys.exit(adapter.main())
"""


def judged(
    tmp_path: Path, command: list[str], *edits: str, validator: list[str] = VALIDATOR
) -> tuple[int, list[dict[str, Any]]]:
    report = tmp_path / "report.json"
    options = [*only(*edits), "--jobs", "2", "--json", str(report)]
    done = run("run_editor.py", *options, "--validator", " ".join(validator), command=command)
    return done.returncode, differences(report)


def test_our_editor_loses_nothing(tmp_path: Path) -> None:
    command = [sys.executable, str(EDITOR)]
    assert judged(tmp_path, command, "newer_version", "packed") == (0, [])


def test_its_own_store_is_valid(corpus: Path) -> None:
    report = validate(corpus / "editing" / "newer_version" / "store.zarr")
    assert report.valid
    assert {problem.code for problem in report.problems} == {"META-004"}


def test_every_edit_names_an_episode_and_changes_it(corpus: Path) -> None:
    files = list((corpus / "editing").glob("*/edit.json"))
    assert len(files) >= 8
    for file in files:
        document = json.loads(file.read_bytes())
        assert (corpus / document["source"]).exists(), file
        assert document["set"], file


# It does what is asked, and then something that it should not have done.
AFTERWARDS = """
import json, shutil
edit = adapter.edit
def of(target, file="zarr.json"):
    return json.loads((target / file).read_bytes())
def spoilt(source, changes, target):
    edit(source, changes, target)
    root, derived = of(target), of(target, "derived/zarr.json")
    exumi, items = root["attributes"]["exumi"], derived["attributes"]["exumi"]
    stream = exumi["streams"]["tactile"]
    {after}
    (target / "zarr.json").write_text(json.dumps(root))
    if (target / "derived").exists():
        (target / "derived/zarr.json").write_text(json.dumps(derived))
adapter.edit = spoilt
"""
KEYS = """
    exumi.pop("weather"), exumi.pop("success"), exumi.update(revision=4), items.pop("farm")
    stream["clock"].pop("later"), stream["light"]["leds"].pop()
    exumi["annotations"]["labels"].pop(0)
    exumi["source"]["node"]["rack"] = 4
"""
ARRAYS = """
    shutil.rmtree(target / "streams/tactile/exposure"), stream["arrays"].remove("exposure")
    shutil.rmtree(target / "derived"), (target / "notes.txt").write_text("mine")
    (source / "zarr.json").write_text("{}")
"""
LOST_KEYS = [
    r"\$\.weather is missing",
    r"\$\.success is missing",
    r"\$\.revision: given 5, written 4",
    r"derived: \$\.farm is missing",
    r"\$\.streams\.tactile\.clock\.later is missing",
    r"\$\.streams\.tactile\.light\.leds: given",
    r"\$\.annotations\.labels: given",
    r"\$\.source\.node\.rack: given 3, written 4",
]
LOST_ARRAYS = [
    r"\$\.streams\.tactile\.arrays: given",
    r"\$\.streams\[tactile\]\.arrays: expected",
    r"derived: \$: given .* written None",
    r"\$\.arrays: expected",
    r"HIER-001 @ notes\.txt",
    "the episode that was given is another one now",
]


@pytest.mark.parametrize(
    ("after", "details"),
    [
        (KEYS, LOST_KEYS),
        (ARRAYS, LOST_ARRAYS),
        ('exumi.update(version="1.0")', [r"\$\.version: given '1.9'", "the reader refuses"]),
        ("raise SystemExit(9)", ["ended with 9"]),
    ],
    ids=["keys", "arrays", "version", "fails"],
)
def test_an_editor_that_loses_something_is_found(
    tmp_path: Path, after: str, details: list[str]
) -> None:
    change = AFTERWARDS.replace("{after}", after.strip())
    spoiled = program(tmp_path / "editor.py", SPOILED.format(change=change))
    # Ours takes its time; where it has nothing to find, one that finds nothing does.
    blind = program(tmp_path / "validator.py", "print('{\"problems\": []}')")
    validator = VALIDATOR if after == ARRAYS else blind
    command = [*spoiled, str(EDITOR)]
    code, found = judged(tmp_path, command, "newer_version", validator=validator)
    assert code == 1
    for detail in details:
        assert [d for d in found if re.search(detail, d["detail"])], (detail, found)


def test_an_editor_may_say_that_it_cannot(tmp_path: Path) -> None:
    refuses = program(tmp_path / "editor.py", "raise SystemExit(3)")
    assert judged(tmp_path, refuses, "packed") == (0, [])
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["not_supported"] == ["packed"]
