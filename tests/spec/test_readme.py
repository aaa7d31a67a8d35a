"""The program in the standard's README reads an episode, with no library of ours."""

import re
import subprocess
import sys
from pathlib import Path

from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_data.builders import CLOCK, encoded_images, jpegs, metadata, times


def test_ten_lines(spec: Path, tmp_path: Path) -> None:
    (code,) = re.findall(
        r"^```python\n(.*?)^```$", (spec / "README.md").read_text(), re.MULTILINE | re.DOTALL
    )
    with EpisodeWriter(tmp_path / "episode.zarr", metadata(), durable=False) as writer:
        images = encoded_images()
        stream = writer.add_stream("tactile_left", kind="tactile", clock=CLOCK, images=images)
        stream.append(times(12), jpegs(12))
    check = "assert frame.shape == (24, 32, 3)\nassert abs(float(time_s) - 0.95) < 1e-9\n"
    check += "import sys\nassert not any(name.startswith('exumi') for name in sys.modules)\n"
    command = [sys.executable, "-c", code + check]
    done = subprocess.run(command, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
