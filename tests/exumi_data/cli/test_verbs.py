"""What each verb prints and does, on data that is as it should be, and on data that is not."""

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from typer.testing import CliRunner, Result

import exumi_data
from exumi_data.catalog import read_catalog
from exumi_data.cli.app import app
from exumi_data.episode import open_episode
from exumi_data.store.pack import pack


def run(*arguments: object) -> Result:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert "Traceback" not in done.output
    return done


def result_of(*arguments: object) -> Any:
    done = run(*arguments, "--format", "json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_validate_a_valid_dataset(dataset: Path, episode: Path) -> None:
    done = run("validate", dataset)
    assert done.exit_code == 0, done.output
    assert "valid" in done.stdout
    report = result_of("validate", episode)
    assert report["valid"] is True
    assert report["kind"] == "episode"
    assert report["coverage"]["frames"] == 6


def test_validate_a_packed_episode(episode: Path) -> None:
    assert result_of("validate", pack(episode))["valid"] is True


def test_validate_finds_damage_and_exits_with_1(dataset: Path, episode: Path) -> None:
    shard = next((episode / "streams" / "tactile" / "data").rglob("c/*"))
    content = bytearray(shard.read_bytes())
    content[700] ^= 0xFF
    shard.write_bytes(content)
    done = run("validate", dataset, "--format", "json")
    assert done.exit_code == 1
    report = json.loads(done.stdout)
    assert report["valid"] is False
    errors = [p for p in report["problems"] if p["severity"] == "error"]
    assert any("tactile" in problem["location"]["path"] for problem in errors)
    # Metadata alone does not show it.
    shallow = run("validate", dataset, "--level", "hierarchy", "--format", "json")
    assert json.loads(shallow.stdout)["coverage"]["levels"] == ["document", "hierarchy"]


def test_validate_prints_for_ci_servers(dataset: Path) -> None:
    junit = run("validate", dataset, "--format", "junit")
    suites = ET.fromstring(junit.stdout)  # noqa: S314  # our own
    assert suites.attrib["failures"] == "0"
    sarif = json.loads(run("validate", dataset, "--format", "sarif").stdout)
    assert sarif["version"] == "2.1.0"
    assert run("validate", dataset, "--format", "xml").exit_code == 2


def test_validate_by_a_configuration(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "work"
    work.mkdir()
    file = work / "exumi.toml"
    file.write_text('[validate.rules]\n"ID-002" = "off"\n')
    monkeypatch.chdir(work)
    assert result_of("validate", dataset)["configuration"]["file"] == str(file)
    assert result_of("validate", dataset, "--no-config")["configuration"] is None
    other = tmp_path / "lab.toml"
    other.write_text('[validate.rules]\n"ID-02" = "off"\n')
    done = run("validate", dataset, "--config", other)
    assert done.exit_code == 2
    assert "there is no rule ID-02, but ID-002" in done.stderr
    assert run("validate", dataset, "--config", tmp_path / "none.toml").exit_code == 2
    assert run("validate", dataset, "--config", file, "--no-config").exit_code == 2


def test_validate_mends_the_catalog_when_it_is_told_to(dataset: Path) -> None:
    catalog = dataset / "catalog.parquet"
    catalog.unlink()
    done = run("validate", dataset, "--fix")
    assert done.exit_code == 0
    assert "catalog.parquet would be rebuilt: 2 added" in done.stdout
    assert "CAT-001" in done.stdout
    assert not catalog.exists()
    report = run("validate", dataset, "--fix", "--apply", "--format", "json")
    assert json.loads(report.stdout)["problems"] == []
    assert "catalog.parquet rebuilt" in report.stderr
    assert read_catalog(dataset) is not None
    assert "belong to --fix" in run("validate", dataset, "--apply").stderr


def test_validate_is_coloured_on_a_terminal_only(
    dataset: Path, exumi: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    plain = exumi("validate", dataset)
    assert "\x1b" not in plain.stdout
    coloured = exumi("validate", dataset, FORCE_COLOR="1", TERM="xterm")
    assert "\x1b[1;32mvalid" in coloured.stdout
    assert re.sub(r"\x1b\[[0-9;]*m", "", coloured.stdout) == plain.stdout


def test_validate_reports_a_missing_shard(episode: Path) -> None:
    shards = (episode / "streams" / "pose" / "data" / "c").rglob("*")
    next(path for path in shards if path.is_file()).unlink()
    done = run("validate", episode)
    assert done.exit_code == 1
    assert "streams/pose/data" in done.stdout


def test_stats_prints_what_it_measured(dataset: Path, episode: Path) -> None:
    text = run("stats", dataset).stdout
    assert "Dataset my-dataset: 2 episodes" in text
    assert "hardness" in text
    assert "feel [it] (2)" in text  # what users wrote is no markup
    document = result_of("stats", episode)
    assert document["what"] == "episode"
    tactile = document["streams"][0]
    assert (tactile["name"], tactile["n"]) == ("tactile", 6)
    assert tactile["rate_hz"]["median"] == pytest.approx(25)
    # Activity is 0, 0.002 ... 0.01: five of six are above the threshold of 0.001.
    assert document["active"] == {
        "episodes": 1,
        "unmeasured": 0,
        "frames": 6,
        "active": 5,
        "ratio": pytest.approx(5 / 6),
    }


def test_stats_names_what_it_could_not_read(dataset: Path, episode: Path) -> None:
    next((episode / "streams" / "pose" / "time").rglob("c/*")).unlink()
    done = run("stats", dataset)
    assert done.exit_code == 1
    assert "1 episode could not be read" in done.stdout
    assert "streams/pose/time" in done.stdout


def test_stats_of_required_streams(episode: Path) -> None:
    document = result_of("stats", episode, "--require", "pose", "--tick", "0.04")
    assert document["usable"]["required"] == ["pose"]
    assert document["usable"]["ticks"] == 6
    missing = run("stats", episode, "--require", "width")
    assert missing.exit_code == 2
    assert "pose, tactile" in missing.stderr


def test_stats_on_a_narrow_terminal(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = run("stats", dataset).stdout
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "tactile" in text
    assert "…" not in text


def test_info_of_an_episode_names_source_and_losses(episode: Path) -> None:
    text = run("info", episode).stdout
    assert "hub_monotonic" in text
    assert "64×48×3" in text
    assert "jpeg, quality 95" in text
    assert "only [a few] frames" in text
    document = result_of("info", episode)
    assert (
        document["metadata"]
        == json.loads((episode / "zarr.json").read_text())["attributes"]["exumi"]
    )
    assert document["samples"] == {"tactile": 6, "pose": 6}
    assert document["derived"]["tactile/activity"]["algorithm"] == "exumi-activity/1"


def test_info_of_a_packed_episode(episode: Path) -> None:
    document = result_of("info", pack(episode))
    assert document["packed"] is True


def test_info_of_a_dataset(dataset: Path) -> None:
    text = run("info", dataset).stdout
    assert "CC0-1.0" in text
    assert "egg (2)" in text
    assert "licences of episodes" not in text  # they are all that of the dataset
    document = result_of("info", dataset)
    assert document["episodes"] == 2
    assert document["labels"] == {"hardness": 2}


def test_index_reads_only_what_changed(dataset: Path, episode: Path) -> None:
    assert "nothing changed" in run("index", dataset).stdout
    before = (dataset / "catalog.parquet").stat().st_mtime_ns
    assert result_of("index", dataset)["written"] is False
    assert (dataset / "catalog.parquet").stat().st_mtime_ns == before

    root = episode / "zarr.json"
    document = json.loads(root.read_text())
    document["attributes"]["exumi"]["operator"] = "p7"
    document["attributes"]["exumi"]["revision"] = 2
    root.write_text(json.dumps(document))
    relative = str(episode.relative_to(dataset))
    change = result_of("index", dataset)
    assert (change["added"], change["updated"], change["removed"]) == ([], [relative], [])
    table = read_catalog(dataset)
    assert table is not None
    assert sorted(table.column("revision").to_pylist()) == [1, 2]


def test_index_sees_a_change_of_what_was_derived(dataset: Path, episode: Path) -> None:
    from exumi_data.store.files import write_atomic

    shard = next((episode / "derived" / "tactile" / "activity").rglob("c/*"))
    other = dataset / "episodes" / "02"
    donor = next((next(other.iterdir()) / "derived" / "tactile" / "activity").rglob("c/*"))
    write_atomic(shard, donor.read_bytes() + b"")
    assert result_of("index", dataset)["updated"] == []  # the same bytes
    write_atomic(shard, b"\0" + donor.read_bytes()[1:])
    done = run("index", dataset, "--format", "json")
    change = json.loads(done.stdout)
    assert change["updated"] == []
    assert len(change["failed"]) == 1
    assert done.exit_code == 1


def test_index_adds_removes_and_names_what_is_broken(dataset: Path, episode: Path) -> None:
    relative = str(episode.relative_to(dataset))
    hidden = dataset / "hidden"
    episode.rename(hidden)
    assert result_of("index", dataset)["removed"] == [relative]
    assert len(exumi_data.open(dataset)) == 1  # type: ignore[arg-type]  # a dataset
    hidden.rename(episode)
    assert result_of("index", dataset)["added"] == [relative]
    (episode / "zarr.json").write_text("{}")
    done = run("index", dataset)
    assert done.exit_code == 1
    assert "1 episode(s) cannot be read" in done.stderr
    assert relative in done.stderr


def test_index_writes_a_missing_catalog(dataset: Path) -> None:
    (dataset / "catalog.parquet").unlink()
    assert len(result_of("index", dataset)["added"]) == 2
    assert len(result_of("index", dataset, "--all")["updated"]) == 0


def test_pack_prints_the_zip_and_leaves_the_folder(episode: Path, tmp_path: Path) -> None:
    done = run("pack", episode)
    assert done.exit_code == 0
    packed = Path(done.stdout.strip())
    assert packed == episode.with_name(episode.name + ".zip")
    with open_episode(packed) as opened, open_episode(episode) as original:
        assert opened.digest() == original.digest()
    again = run("pack", episode)
    assert again.exit_code == 2
    assert "already exists" in again.stderr
    assert run("pack", episode, "--overwrite").exit_code == 0
    other = tmp_path / "release" / "a.zarr.zip"
    assert run("pack", episode, "--to", other, "--quiet").stderr == ""
    assert other.read_bytes() == packed.read_bytes()
    assert "packed already" in run("pack", packed).stderr


def test_prepare_makes_a_training_set(dataset: Path, tmp_path: Path) -> None:
    target = tmp_path / "training"
    done = run("prepare", dataset, target, "--size", "32", "--gray", "--workers", "1")
    assert done.exit_code == 0, done.output
    assert "2 written of 2 episodes; 12 frames" in done.stdout
    assert f"Next: exumi validate {target}" in done.stderr
    stored = result_of("info", target)["streams"]
    assert (stored[0]["name"], stored[0]["encodings"]) == ("tactile", ["encoded"])
    again = result_of("prepare", dataset, target, "--size", "32", "--gray", "--workers", "1")
    assert (again["converted"], again["skipped"], again["failed"]) == (0, 2, [])
    assert run("validate", target).exit_code == 0


def test_prepare_combines_two_fingers_and_rectifies_cameras(tmp_path: Path) -> None:
    played, target = tmp_path / "demo", tmp_path / "training"
    assert run("demo", "--direct", "--out", played, "--seconds", "6").exit_code == 0
    looks = ("--tactile", "combined", "--rgb", "rectify", "--fov", "50", "--pair-within", "0.02")
    done = run("prepare", played / "dataset", target, "--size", "48", "--workers", "1", *looks)
    assert done.exit_code == 0, done.output
    names = {stream["name"] for stream in result_of("info", target)["streams"]}
    assert names == {"tactile_combined", "rgb", "pose", "width"}
    for root in (played / "dataset", target):
        assert not result_of("validate", root)["problems"]
    # The refused option says what would have done.
    alone = run("prepare", played / "dataset", tmp_path / "x", "--tactile", "both")
    assert alone.exit_code == 2
    assert "separate" in alone.output
