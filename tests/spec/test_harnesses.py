"""The harnesses accept what conforms, and find what does not.

All of the corpus goes through them in `make conformance`; here it is a sample.
"""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from exumi_data.standard import rules

SPEC = Path(__file__).resolve().parents[2] / "spec"
CONFORMANCE = SPEC / "conformance"
VALIDATOR = [sys.executable, "-m", "exumi_data.cli", "validate", "--format", "json"]
WRITER = [sys.executable, str(CONFORMANCE / "adapters" / "exumi_writer.py")]
READER = [sys.executable, str(SPEC / "readers" / "dump.py")]
SAMPLE = ("TIME-001__*", "CAT-004__*", "PACK-005__*", "ANN-001__*", "pose__minimal")


def run(harness: str, *options: str, command: list[str]) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, str(CONFORMANCE / harness), *options, "--", *command]
    return subprocess.run(program, check=False, capture_output=True, text=True)


def only(*patterns: str) -> list[str]:
    return [word for pattern in patterns for word in ("--only", pattern)]


def program(path: Path, code: str) -> list[str]:
    """A command that runs some Python."""
    path.write_text(code)
    return [sys.executable, str(path)]


def differences(path: Path) -> list[dict[str, Any]]:
    document = json.loads(path.read_text())
    found: list[dict[str, Any]] = document["differences"]
    return found


def test_harnesses_need_nothing_but_python() -> None:
    files = [*CONFORMANCE.glob("run_*.py"), *(CONFORMANCE / "harness").glob("*.py")]
    assert len(files) > 6
    names = ", ".join(path.stem for path in CONFORMANCE.glob("run_*.py"))
    code = f"import sys; sys.path.insert(0, sys.argv[1]); import {names}"
    isolated = [sys.executable, "-I", "-S", "-c", code, str(CONFORMANCE)]
    done = subprocess.run(isolated, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_rule_table_for_others_is_ours(spec: Path) -> None:
    table = json.loads((spec / "1.0" / "rules.json").read_text("utf-8"))["rules"]
    ours = {rule.id: (rule.level, rule.severity) for rule in rules().values()}
    assert {code: (rule["level"], rule["severity"]) for code, rule in table.items()} == ours


# ------------------------------------------------------------------------------------- validators


def test_our_validator_conforms(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    options = [*only(*SAMPLE), "--jobs", "2", "--json", str(report)]
    done = run("run_validator.py", *options, command=VALIDATOR)
    assert done.returncode == 0, done.stdout
    assert len(json.loads(report.read_text())["cases"]) == len(SAMPLE)
    assert differences(report) == []


BLIND = "print('{\"problems\": []}')"
WRONG_PLACE = """
import json, sys, pathlib
expected = json.loads((pathlib.Path(sys.argv[1]).parent / "expected.json").read_bytes())
problems = [
    {"code": f["code"], "location": {**f, "path": f["path"] + "/data"}}
    for f in expected["findings"]
]
problems.append({"code": "acme:OWN-001", "location": {"path": "zarr.json"}})
print(json.dumps({"problems": problems}))
sys.exit(1 if problems[1:] else 0)
"""
EAGER = """
import json
print(json.dumps({"problems": [{"code": "LIC-001", "location": {"path": "zarr.json"}}]}))
raise SystemExit(1)
"""


@pytest.mark.parametrize(
    ("code", "what", "case"),
    [
        (BLIND, {"missing", "exit code"}, "TIME-001__*"),
        (EAGER, {"unexpected", "exit code"}, "pose__minimal"),
        (WRONG_PLACE, {"missing", "unexpected"}, "TIME-001__*"),
        ("print('all is well')", {"answer"}, "pose__minimal"),
        ("raise SystemExit(2)", {"answer"}, "pose__minimal"),
        ("print('{\"problems\": [{}]}')", {"answer"}, "pose__minimal"),
        ("import time; time.sleep(60)", {"answer"}, "pose__minimal"),
    ],
    ids=["blind", "eager", "wrong place", "no json", "gives up", "no code", "hangs"],
)
def test_a_validator_that_does_not_conform_is_found(
    tmp_path: Path, code: str, what: set[str], case: str
) -> None:
    report = tmp_path / "report.json"
    options = [*only(case), "--timeout", "2", "--json", str(report)]
    done = run("run_validator.py", *options, command=program(tmp_path / "validator.py", code))
    assert done.returncode == 1, done.stdout
    assert {difference["what"] for difference in differences(report)} == what
    assert re.search(r"1 cases: 0 as expected, 1 not", done.stdout)


def test_own_rules_of_a_validator_and_other_levels_are_not_compared(tmp_path: Path) -> None:
    blind = program(tmp_path / "blind.py", BLIND)
    options = [*only("TIME-001__*"), "--levels", "document,hierarchy"]
    assert run("run_validator.py", *options, command=blind).returncode == 0
    own = BLIND.replace(
        "[]", '[{\\"code\\": \\"acme:A-1\\", \\"location\\": {\\"path\\": \\"x\\"}}]'
    )
    judged = run(
        "run_validator.py", *only("pose__minimal"), command=program(tmp_path / "own.py", own)
    )
    assert judged.returncode == 0, judged.stdout


def test_what_cannot_be_run_is_said() -> None:
    done = run("run_validator.py", *only("pose__minimal"), command=["/no/such/validator"])
    assert done.returncode == 2
    assert "/no/such/validator" in done.stderr
    assert run("run_validator.py", *only("NO-SUCH*"), command=["true"]).returncode == 2


EVERY_SAMPLE = """
import json
where = {"path": "streams/pose/time"}
problems = [{"code": "TIME-001", "location": where | {"index": i}} for i in (2, 3)]
print(json.dumps({"problems": problems}))
raise SystemExit(1)
"""


def test_how_many_samples_are_reported_is_free_unless_asked(tmp_path: Path) -> None:
    command = program(tmp_path / "validator.py", EVERY_SAMPLE)
    options = only("TIME-001__tie")
    assert run("run_validator.py", *options, command=command).returncode == 0
    exact = run("run_validator.py", *options, "--exact", command=command)
    assert exact.returncode == 1
    assert "unexpected" in exact.stdout


ADAPTER = CONFORMANCE / "adapters" / "exumi_validator.py"
STOPS = """
import json
print(json.dumps({"problems": [], "exit_code": 0}), flush=True)
raise SystemExit("no more")
"""


def test_a_batch_is_judged_like_single_cases(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    options = [*only(*SAMPLE), "--batch", "--exact", "--json", str(report)]
    done = run("run_validator.py", *options, command=[sys.executable, str(ADAPTER)])
    assert done.returncode == 0, done.stdout
    assert differences(report) == []


def test_a_batch_that_stops_half_way_is_found(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    options = [*only("pose__*"), "--batch", "--json", str(report)]
    done = run("run_validator.py", *options, command=program(tmp_path / "v.py", STOPS))
    assert done.returncode == 1
    cases = json.loads(report.read_text())["cases"]
    assert [d["case"] for d in differences(report)] == cases[1:]
    assert all("no more" in d["detail"] for d in differences(report))


# ---------------------------------------------------------------------------------------- writers


def judged(tmp_path: Path, command: list[str], *cases: str) -> tuple[int, list[dict[str, Any]]]:
    report = tmp_path / "report.json"
    validator = " ".join(VALIDATOR)
    options = [*only(*cases), "--jobs", "2", "--json", str(report), "--validator", validator]
    done = run("run_writer.py", *options, command=command)
    return done.returncode, differences(report)


def test_our_writer_conforms(tmp_path: Path) -> None:
    cases = ("tactile__reference", "time__clock_corrected")
    assert judged(tmp_path, WRITER, *cases) == (0, [])


SPOILED = """
import importlib.util, sys
spec = importlib.util.spec_from_file_location("adapter", sys.argv.pop(1))
adapter = importlib.util.module_from_spec(spec)
spec.loader.exec_module(adapter)
{change}
sys.exit(adapter.main())
"""
LATE = """
load = adapter.load
adapter.load = lambda folder, about: load(folder, about) + (about["file"].endswith("/time.bin"))
"""
REENCODED = """
import numpy as np, pathlib
from exumi_data.store import jpeg
read = pathlib.Path.read_bytes
def again(path):
    data = read(path)
    if path.suffix != ".jpg":
        return data
    frame = np.empty((16, 16, 3), np.uint8)
    jpeg.decode_into(data, frame)
    return jpeg.encode(frame, 95)
pathlib.Path.read_bytes = again
"""
FORGETFUL = """
stream = adapter.write_stream
def forgetful(writer, folder, about):
    about["fields"].pop("mm_per_px", None)
    stream(writer, folder, about)
adapter.write_stream = forgetful
"""
INVALID = """
write = adapter.write
def invalid(folder, target):
    write(folder, target)
    (target / "notes.txt").write_text("mine")
adapter.write = invalid
"""


@pytest.mark.parametrize(
    ("change", "what", "detail"),
    [
        (LATE, "content", r"\$\.streams\[tactile\]\.arrays\[time\]\.sha256"),
        (REENCODED, "content", r"\$\.streams\[tactile\]\.images\.frames\[0\]\.sha256"),
        (FORGETFUL, "metadata", r"\$\.streams\.tactile\.mm_per_px is missing"),
        (INVALID, "invalid", r"HIER-001 @ notes\.txt"),
        ("adapter.write = lambda folder, target: None", "answer", "wrote nothing"),
        ("raise SystemExit(9)", "answer", "ended with 9"),
    ],
    ids=["late", "reencoded", "forgetful", "invalid", "idle", "fails"],
)
def test_a_writer_that_does_not_conform_is_found(
    tmp_path: Path, change: str, what: str, detail: str
) -> None:
    spoiled = program(tmp_path / "writer.py", SPOILED.format(change=change))
    code, found = judged(tmp_path, [*spoiled, WRITER[-1]], "tactile__reference")
    assert code == 1
    assert [d for d in found if d["what"] == what and re.search(detail, d["detail"])], found


def test_a_writer_may_say_that_it_cannot_write_something(tmp_path: Path) -> None:
    refuses = program(tmp_path / "writer.py", "raise SystemExit(3)")
    assert judged(tmp_path, refuses, "tactile__reference") == (0, [])
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["not_supported"] == ["tactile__reference"]


# ---------------------------------------------------------------------------------------- readers


def test_our_reader_refuses_what_it_has_to() -> None:
    cases = ("images__encoded", "packed__derived", "DOC-005__newer_split", "ROOT-003__packed")
    damaged = ("SHARD-002__index_checksum", "SHARD-003__*", "IMG-005__checksum", "SAFE-002__link")
    done = run("run_reader.py", *only(*cases, *damaged), command=READER)
    assert done.returncode == 0, done.stdout
    assert "8 cases: 8 as expected" in done.stdout


@pytest.mark.parametrize(
    ("code", "case", "detail"),
    [
        ("raise SystemExit('not this one')", "DOC-005__newer_major", "does not name 2.0"),
        ("print('{}')", "ROOT-003__unknown_feature", "expected 1, found 0"),
        ("print('{}')", "pose__minimal", "$.id: missing"),
        ("print('{')", "pose__minimal", "no JSON"),
        ("print('{}')", "SHARD-001__deleted", "expected 1, found 0"),
        ("raise SystemExit(1)", "SAFE-001__parent_folder", "stderr does not say why"),
    ],
    ids=["silent", "careless", "empty", "no json", "fills in", "without a word"],
)
def test_a_reader_that_does_not_conform_is_found(
    tmp_path: Path, code: str, case: str, detail: str
) -> None:
    reader = program(tmp_path / "reader.py", code)
    done = run("run_reader.py", *only(case), command=reader)
    assert done.returncode == 1
    assert detail in done.stdout


@pytest.mark.parametrize(
    "options",
    [("--jobs", "0"), ("--timeout", "-1"), ("--json", "/no/such/folder/report.json")],
)
def test_wrong_options_are_said_before_the_work(tmp_path: Path, options: tuple[str, str]) -> None:
    done = run("run_validator.py", *options, command=program(tmp_path / "any.py", "pass"))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert f"argument {options[0]}" in done.stderr


def test_an_answer_without_end_is_a_wrong_answer(tmp_path: Path) -> None:
    endless = program(tmp_path / "endless.py", "print('[' * 100_000)")
    done = run("run_validator.py", *only("pose__minimal"), command=endless)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "nested too deeply" in done.stdout
