"""The Guessing Game is played, on simulated touches and on real ones where there are some."""

import json
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from exumi_converters import ConvertOptions, convert
from exumi_data.demo import TouchSettings, write_touch_dataset

EXAMPLE = Path(__file__).parents[2] / "examples" / "guessing_game.py"


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLE), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def touches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("touches") / "touches"
    write_touch_dataset(root, TouchSettings(parts=26, clips=3), workers=1)
    return root


def shares(results: Any) -> tuple[list[float], dict[tuple[str, str, str], dict[str, float]]]:
    games = [game["right"]["value"] for game in results["guessing_game"]]
    sortings = {
        (one["property"], one["tested"], one["method"]): one["right"] for one in results["sorting"]
    }
    return games, sortings


def test_simulated_parts_are_guessed_and_sorted(touches: Path) -> None:
    done = run(touches, "--json", "--rounds", 2)
    assert done.returncode == 0, done.stderr
    results = json.loads(done.stdout)
    assert (results["clips"], results["parts"]) == (78, 26)
    games, sortings = shares(results)
    # Far above chance, which is one in five: ratings are felt, and parts are known again.
    assert games[0] > 0.4
    assert games[1] > 0.7
    assert games[2] > games[0]
    assert len(sortings) == 8
    assert all(right["low"] > 0.6 for right in sortings.values())
    told = results["told"]
    assert told["game"]["answer"] in told["game"]["options"]
    assert set(told["game"]["guess_by_clips_taught"]) == {"0", "1", "2"}
    for orders in told["sorting"].values():
        assert sorted(orders["by_touch"]) == sorted(orders["as_rated"])


def test_the_story_is_told(touches: Path) -> None:
    done = run(touches, "--rounds", 1)
    assert done.returncode == 0, done.stderr
    assert "which option the touched object is likely to be" in done.stdout
    assert done.stdout.count("Taught ") == 2
    assert "Most similar objects (in order of decreasing similarity)" in done.stdout
    assert "in decreasing hardness" in done.stdout
    assert done.stdout.count("%") == 3 * (3 + 8) + 2


def test_what_cannot_be_played_is_said_in_one_line(
    touches: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = tmp_path / "few"
    write_touch_dataset(few, TouchSettings(parts=2, clips=1), workers=1)
    (episode, *_) = sorted(touches.glob("episodes/*/*.zarr"))
    for path, said in ((few, "a game needs 5"), (episode, "give a dataset"), ("no", "no such")):
        monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(path)])
        with pytest.raises(SystemExit, match=f"^error: .*{said}"):
            runpy.run_path(str(EXAMPLE), run_name="__main__")


def test_real_parts_are_guessed_and_sorted(real_data: Path, tmp_path: Path) -> None:
    source = real_data.resolve() / "physiclear"
    options = ConvertOptions(labels=source / "labels.csv")
    videos = tmp_path / "videos"
    videos.mkdir()
    rated = {line.split(",")[0] for line in (source / "labels.csv").read_text().splitlines()[1:]}
    clips: dict[str, list[Path]] = {}
    for video in sorted((source / "videos").glob("*.mov")):
        clips.setdefault(video.stem.rpartition("_")[0], []).append(video)
    chosen = [part for part in sorted(clips) if part in rated and len(clips[part]) > 2][:26]
    for part in chosen:
        for video in clips[part][:3]:
            (videos / video.name).symlink_to(video)
    convert(videos, tmp_path / "set", from_format="octopi", options=options)
    done = run(tmp_path / "set", "--json", "--rounds", 2)
    assert done.returncode == 0, done.stderr
    games, sortings = shares(json.loads(done.stdout))
    assert games[1] > 0.6
    assert games[2] > 0.7
    assert all(right["value"] > 0.55 for right in sortings.values())
