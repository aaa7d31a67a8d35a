"""The training example runs as it stands, and learns."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

from exumi_data.catalog import build_catalog, write_catalog

EXAMPLE = Path(__file__).parents[2] / "examples" / "train_tpp.py"


def start(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLE), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_it_learns_and_says_how_well_it_predicts(play: Path, tmp_path: Path) -> None:
    weights = tmp_path / "weights.pt"
    options = ("--small", "--steps", "61", "--batch-size", "16", "--held-out", "16")
    done = start(play, *options, "--mask", "rgb", "--save", weights)
    assert done.returncode == 0, done.stderr
    losses = [float(value) for value in re.findall(r"reconstruction (\S+)", done.stdout)]
    assert len(losses) == 4
    assert losses[-1] < 0.9 * losses[0]
    assert "of them active" in done.stdout
    errors = [float(value) for value in re.findall(r"^  .+  (0\.\d+)$", done.stdout, re.MULTILINE)]
    one_draw, four_draws, *_, floor = errors
    assert len(errors) == 5
    assert floor < four_draws < one_draw
    assert weights.stat().st_size > 100_000


def test_one_episode_is_refused(play: Path) -> None:
    (episode, *_) = sorted(play.glob("episodes/*/*.zarr"))
    done = start(episode)
    assert done.returncode == 2
    assert "give a dataset" in done.stderr


def test_too_few_episodes_are_said(play: Path, tmp_path: Path) -> None:
    (kept, *_) = sorted(play.glob("episodes/*/*.zarr"))
    copy = tmp_path / "one"
    shutil.copytree(kept, copy / kept.relative_to(play))
    shutil.copy(play / "dataset.json", copy)
    write_catalog(copy, build_catalog(copy, workers=1)[0])
    done = start(copy, "--small")
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert "there may be too few" in done.stderr
