"""The report: data first, text made from it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from exumi_data.standard import LEVELS, Level
from exumi_validators import Coverage, Location, Problem, Report, Unchecked, validate
from exumi_validators.findings import Collector, json_pointer, problem, show
from tests.exumi_data.builders import edit_metadata


def report(*problems: Problem, unchecked: tuple[Unchecked, ...] = ()) -> Report:
    return Report(
        path="data",
        kind="episode",
        standard="1.0",
        library="0",
        problems=problems,
        coverage=Coverage(levels=("document",), unchecked=unchecked),
    )


ERROR = problem("TIME-001", "streams/pose/time", index=2, expected=5, found=5)
WARNING = problem("POSE-002", "streams/pose/data", index=1, detail=1)
INFO = problem("SPLIT-008", "splits/a.json", found=1, detail="x")


def test_a_message_says_what_where_and_what_to_do() -> None:
    assert ERROR.message == "sample 2 is at 5 ns, after one at 5 ns"
    assert ERROR.location == Location("streams/pose/time", index=2)
    assert (ERROR.expected, ERROR.found) == ("5", "5")
    assert ERROR.rule == "1.0/episode.md#TIME-001"
    assert ERROR.suggestion


@pytest.mark.parametrize(
    ("problems", "valid"),
    [((), True), ((WARNING, INFO), True), ((ERROR,), False), ((WARNING, ERROR), False)],
)
def test_errors_decide(problems: tuple[Problem, ...], valid: bool) -> None:
    made = report(*problems)
    assert made.valid == valid
    assert made.exit_code == (0 if valid else 1)


def test_what_could_not_be_checked_is_no_pass() -> None:
    made = report(unchecked=(Unchecked(".", "TIME-001", "MemoryError"),))
    assert not made.valid
    assert made.exit_code == 1
    assert "not fully checked" in made.to_text()
    assert "not checked: TIME-001: MemoryError" in made.to_text()


def test_json_is_canonical() -> None:
    made = report(ERROR, WARNING)
    text = made.to_json()
    assert text == report(ERROR, WARNING).to_json()
    assert text.isascii()
    document = json.loads(text)
    assert document["counts"] == {"error": 1, "warning": 1, "info": 0, "suppressed": 0}
    assert document["problems"][0]["location"] == {
        "path": "streams/pose/time",
        "episode": None,
        "pointer": None,
        "index": 2,
    }
    assert document == json.loads(json.dumps(made.to_dict()))


def test_text_is_grouped_by_file(episode: Path) -> None:
    edit_metadata(episode, lambda exumi: exumi.update(colour="red", shape="round"))
    (episode / "streams/width/data/c/0").unlink()
    lines = validate(episode).to_text().splitlines()
    assert lines[0].endswith(": invalid (3 errors)")
    assert "rules of exUMI 1.0" in lines[1]
    assert lines.count("zarr.json") == 1
    at = lines.index("zarr.json")
    assert "META-003: unknown key colour @ /attributes/exumi/colour" in lines[at + 1]
    assert "META-003: unknown key shape" in lines[at + 3]
    assert "streams/width/data" in lines


def test_hostile_text_cannot_write_to_the_terminal(episode: Path) -> None:
    edit_metadata(episode, lambda exumi: exumi.update({"\x1b[2Jclear": 1, "a\nb": 2}))
    made = validate(episode)
    assert made.codes() == {"META-003": 2}
    assert all(line.isprintable() for line in made.to_text().splitlines())


def test_long_values_are_cut() -> None:
    assert len(show("x" * 100_000)) == 200
    assert len(show(list(range(10_000)))) == 200
    assert show(3) == "3"
    assert show(float("nan")) == "NaN"
    assert show("grün") == "grün"
    assert show(b"\xff") == "bytes"


def test_pointers_are_escaped() -> None:
    assert json_pointer(("a/b", "c~d", 0)) == "/a~1b/c~0d/0"


def test_a_million_mistakes_make_no_endless_report(episode: Path) -> None:
    many = {f"key{number}": 1 for number in range(5_000)}
    edit_metadata(episode, lambda exumi: exumi.update(many))
    made = validate(episode)
    assert made.count("error") == 100
    assert made.not_listed == {"META-003": 4_900}
    assert made.codes() == {"META-003": 5_000}
    assert "... and 4,900 more of META-003" in made.to_text(verbose=True)
    summed_up = made.to_text()
    assert "invalid (5,000 errors)" in summed_up
    assert "error META-003: 5,000; the rule is: unknown keys are named vendor:name" in summed_up
    assert "... and 4,997 more" in summed_up
    assert len(summed_up.splitlines()) < 40


def test_the_same_problem_is_listed_once() -> None:
    collector = Collector()
    for _ in range(3):
        collector.add(ERROR)
    assert collector.problems == (ERROR,)


@pytest.mark.parametrize(
    ("levels", "verdict"),
    [
        (("document",), "valid up to level document"),
        (("document", "hierarchy", "arrays"), "valid up to level arrays"),
        (("document", "arrays"), "valid at levels document, arrays"),
        (LEVELS, "valid"),
    ],
)
def test_a_pass_says_how_far_it_was_looked(levels: tuple[Level, ...], verdict: str) -> None:
    made = report()
    made = replace(made, coverage=replace(made.coverage, levels=levels))
    assert made.to_text().splitlines()[0] == f"{made.path}: {verdict}"
