"""The package ``lerobot`` itself reads what we write, and we read what it writes.

Runs where ``EXUMI_LEROBOT_PYTHON`` names the interpreter of an environment that has it
(`scripts/interop_lerobot.py` says how to make one).
"""

import json
import os
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_converters import ConvertOptions, ExportOptions, convert, export
from exumi_data.dataset import open_dataset
from tests.exumi_converters.whole import write_dataset

ROOT = Path(__file__).parents[3]
PYTHON = os.environ.get("EXUMI_LEROBOT_PYTHON", "")
pytestmark = pytest.mark.skipif(not PYTHON, reason="EXUMI_LEROBOT_PYTHON is not set")
STATE_ROUNDING = 1e-6


def lerobot(*arguments: str | Path) -> None:
    script = ROOT / "scripts" / "interop_lerobot.py"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    environment |= {"HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"}
    done = subprocess.run(
        [PYTHON, str(script), *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.mark.parametrize(("codec", "fps"), [("av1", "30"), ("h264", "60000/1001")])
def test_lerobot_reads_what_we_write(tmp_path: Path, codec: str, fps: str) -> None:
    source = write_dataset(tmp_path / "ours", 3, seconds=0.6, tactile=2)
    told = ExportOptions(durable=False, settings={"codec": codec, "fps": fps, "crf": "20"})
    export(source, tmp_path / "out", to_format="lerobot", options=told)
    lerobot("read", tmp_path / "out", tmp_path / "got")
    got = json.loads((tmp_path / "got.json").read_text())
    arrays: Any = np.load(tmp_path / "got.npz", allow_pickle=False)
    dataset, rate = open_dataset(source), Fraction(fps)
    count = got["lengths"][0]
    assert count == (17 if fps == "30" else 32)
    assert (got["episodes"], got["frames"]) == (3, 3 * count)
    assert abs(got["fps"] - float(rate)) < 1e-9
    assert got["index"] == list(range(3 * count))
    assert got["frame_index"] == [*range(count)] * 3
    times = np.tile(np.arange(count) / float(rate), 3)
    np.testing.assert_array_equal(np.array(got["timestamp"], np.float32), times.astype(np.float32))
    texts = [dataset[name].metadata.task.instruction for name in dataset.ids]
    assert got["task"] == [text for text in texts for _ in range(count)]
    assert got["window"]["observation.images.rgb"][0] == 3
    for number, name in enumerate(dataset.ids):
        with dataset[name] as episode:
            rows = slice(number * count, (number + 1) * count)
            _check_pictures(episode["rgb"], arrays["observation.images.rgb"][rows], rate)
            _check_pictures(
                episode["tactile_left"], arrays["observation.images.tactile_left"][rows], rate
            )
    # Its own statistics are histograms': equal but for a bin's width.
    for key in [name for name in arrays.files if name.startswith("theirs/")]:
        _, feature, name = key.split("/")
        spread = np.ptp(arrays[feature], axis=0).max() / 1000 + 1e-6
        near = spread if name.startswith("q") else 1e-4 * max(1.0, np.abs(arrays[key]).max())
        np.testing.assert_allclose(
            arrays[f"ours/{feature}/{name}"], arrays[key], atol=near, err_msg=key
        )


def _check_pictures(stream: Any, found: np.ndarray, rate: Fraction) -> None:
    start = 33_333_333  # of the first camera frame that all streams have begun by
    ticks = start + np.arange(len(found)) / float(rate) * 1e9
    nearest = np.abs(stream.time[None] - ticks[:, None]).argmin(axis=1)
    expected = stream.frames[nearest].astype(int)
    assert np.abs(found - expected).mean() < 3
    # Each is nearer to its own frame than to the one after: a stripe moves between them.
    after = np.roll(expected, -2, axis=0)
    assert np.abs(found - expected).mean() < np.abs(found - after).mean()


def test_we_read_what_lerobot_writes(tmp_path: Path) -> None:
    lerobot("write", tmp_path / "theirs")
    truth: Any = np.load(tmp_path / "theirs.npz", allow_pickle=False)
    told = ConvertOptions(workers=1, durable=False, settings={"tactile": "observation.images.gel"})
    report = convert(tmp_path / "theirs", tmp_path / "read", options=told)
    assert not report.failed
    episodes = {e.metadata.source.key: e for e in open_dataset(tmp_path / "read")}
    for number, key in enumerate(sorted(map(str, episodes))):
        episode, frames = episodes[key], truth[f"frames{number}"]
        states = truth[f"state{number}"].astype(np.float64)
        np.testing.assert_allclose(episode["pose"].data, states[:, :7], atol=STATE_ROUNDING)
        np.testing.assert_allclose(episode["grip"].data, states[:, 7], atol=STATE_ROUNDING)
        np.testing.assert_array_equal(episode["side"].frames[:], frames[:, :, ::-1])
        assert episode["front"].metadata.images.encoding == "video"  # type: ignore[attr-defined]
        assert np.abs(episode["front"].frames[:].astype(int) - frames).mean() < 3
        assert np.abs(episode["gel"].frames[:].astype(int) - frames[:, ::-1]).mean() < 3
        assert episode.metadata.task.name == f"task {number % 2}"
