"""``exumi convert``: the list, the plan, and the other direction."""

import json
from pathlib import Path

import pytest

from tests.exumi_data.cli.conftest import Program


def test_the_list_names_formats_options_and_losses(exumi: Program) -> None:
    done = exumi("convert", "--list")
    assert done.returncode == 0
    for line in ("--from octopi:", "--to mcap:", "  loses identity:", "  -o video=..."):
        assert line in done.stdout
    one = json.loads(exumi("convert", "--list", "mcap", "--format", "json").stdout)
    assert [entry["direction"] for entry in one] == ["--from", "--to"]
    assert set(one[1]["options"]) == {"video"}
    done = exumi("convert", "--list", "zoo")
    assert done.returncode == 2
    assert "Supported values are clips" in done.stderr


def test_a_dry_run_says_what_would_be_lost_and_writes_nothing(
    exumi: Program, dataset: Path, tmp_path: Path
) -> None:
    done = exumi("convert", dataset, tmp_path / "out", "--to", "mcap", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert "would write 2 episodes" in done.stdout
    assert not (tmp_path / "out").exists()
    plan = json.loads(exumi("convert", dataset, "--to", "mcap", "--dry-run", "-f", "json").stdout)
    assert len(plan["items"]) == 2


def test_a_dataset_goes_out_and_comes_back(exumi: Program, dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = exumi("convert", dataset, out, "--to", "mcap", "--format", "json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["written"], report["failed"]) == (2, [])
    again = exumi("convert", dataset, out, "--to", "mcap")
    assert "there already, 2 episodes" in again.stdout
    plan = exumi("convert", out, "--dry-run")
    assert plan.returncode == 0, plan.stderr
    assert "mcap/1" in plan.stdout
    assert "read as mcap" in plan.stdout
    back = exumi("convert", out, tmp_path / "back", "--licence", "CC0-1.0")
    assert back.returncode == 0, back.stderr
    assert "2 written of 2 episodes" in back.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--to", "zoo"), "Invalid format (zoo)"),
        (("--licence", "bogus"), "'bogus' is no SPDX licence expression"),
        (("--from", "umi", "--to", "mcap"), "converted to exUMI first"),
        (("--to", "mcap", "-o", "video"), "Invalid option (video)"),
        (("--to", "mcap", "-o", "video=gif"), "Invalid video (gif)"),
        (("--to", "mcap", "-o", "a=1", "-o", "a=2"), "given twice"),
        (("--from", "mcap", "-o", "speed=1"), "no option 'speed'"),
        ((), "is an exUMI dataset already"),
    ],
)
def test_mistakes_are_said_in_one_message(
    exumi: Program, dataset: Path, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    done = exumi("convert", dataset, tmp_path / "out", *arguments)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_what_is_missing_is_said(exumi: Program) -> None:
    assert "SRC and DST are missing" in exumi("convert").stderr
    assert "DST is missing" in exumi("convert", "a").stderr


def test_the_list_fits_into_80_columns(exumi: Program) -> None:
    said = exumi("convert", "--list", COLUMNS="80").stdout
    assert max(map(len, said.splitlines())) <= 80
    assert "One of: av1, h264. Default: av1." in " ".join(said.split())


def test_names_of_files_do_not_reach_the_terminal_as_codes(exumi: Program, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "\x1b[31mred.mcap").write_text("no")
    done = exumi("convert", tmp_path / "in", tmp_path / "out", "--from", "mcap")
    assert done.returncode == 1
    assert "\x1b" not in done.stdout + done.stderr
    assert "red.mcap: is no MCAP file" in done.stderr
