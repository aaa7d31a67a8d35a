"""What is found does not depend on how arrays are chunked, nor on how much is read at once."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.episode import open_episode
from exumi_data.model import Clock, Frames
from exumi_data.standard import rules
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.shards import ArrayWriter
from exumi_validators import context, validate
from exumi_validators.config import read_config
from exumi_validators.windows import windows
from tests.exumi_data.builders import metadata

HOST = Clock(source="host", stamp_point="user_rx")
CHUNK_ROWS = (1000, 65_536, 1 << 20)


class Blocks:
    """Arrays that are read in blocks of given lengths."""

    def __init__(self, *lengths: int) -> None:
        self.lengths = lengths

    def limit(self, code: str, name: str) -> float:
        assert (code, name) == ("TIME-005", "window_samples")
        return 10.0

    def blocks(self, *paths: str) -> Any:
        start = 0
        for length in self.lengths:
            rows = np.arange(start, start + length)
            yield start, tuple(rows * (place + 1) for place in range(len(paths)))
            start += length


@pytest.mark.parametrize(
    "lengths", [(), (1,), (9,), (10,), (11,), (3, 3, 3), (5, 5), (7, 26), (40,), (1,) * 33]
)
def test_windows_are_cut_at_the_same_samples(lengths: tuple[int, ...]) -> None:
    found = list(windows(Blocks(*lengths), "a", "b"))  # type: ignore[arg-type]  # only its blocks and one limit are asked for
    total = sum(lengths)
    assert [start for start, _ in found] == list(range(0, total, 10))
    for start, (first, second) in found:
        assert first.tolist() == list(range(start, min(start + 10, total)))
        assert (second == 2 * first).all()


def test_the_text_has_their_lengths() -> None:
    page = Path(__file__).parents[2] / "spec" / "1.0" / "quality.md"
    text = " ".join(page.read_text("utf-8").split())
    limits = rules()["TIME-005"].limits
    assert f"windows** of {limits['window_samples']:,} samples".replace(",", " ") in text
    assert f"up to {limits['carried_samples']} samples before it" in text


def test_windows_can_be_of_another_length(defective: Path, tmp_path: Path) -> None:
    """With one long window the halved rate and the steady one make no window of their own."""
    config = tmp_path / "exumi.toml"
    config.write_text('[validate.rules]\n"TIME-005" = {limits = {window_samples = 100000}}\n')
    usual, told = (
        [(p.code, p.message) for p in validate(defective, levels=["arrays"], config=c).problems]
        for c in (None, read_config(config))
    )
    assert usual != told


def rechunked(path: Path, chunk_rows: int) -> Path:
    """A copy of an episode whose arrays of samples have chunks of another length."""
    copy = path.with_name(f"{chunk_rows}.zarr")
    shutil.copytree(path, copy)
    with open_episode(path) as episode:
        for name, stream in episode.streams.items():
            for array in stream.metadata.arrays:
                values = np.asarray(stream.array(array))
                folder = copy / "streams" / name / array
                names = json.loads((folder / "zarr.json").read_text("utf-8"))["dimension_names"]
                shutil.rmtree(folder)
                writer = ArrayWriter(
                    folder,
                    values.dtype,
                    values.shape[1:],
                    chunk_rows=chunk_rows,
                    zstd=True,
                    dimension_names=tuple(names),
                )
                writer.append(values)
                writer.finish()
    return copy


@pytest.fixture(scope="module")
def defective(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An episode of 90,000 samples whose defects are small in one window, or in one block."""
    rng = np.random.default_rng(4)
    # The rate halves in the middle, a counter leaves out numbers, clocks step and drift apart.
    steps = np.where(np.arange(90_000) < 45_000, 1_000_000, 2_000_000)
    steps[70_000] += 7_000_000
    time = np.cumsum(steps + rng.integers(-50_000, 50_000, len(steps)))
    sequence = np.arange(len(time)) + 4 * (np.arange(len(time)) > 66_000)
    device = time + np.where(np.arange(len(time)) > 64_000, 40_000_000, 0)
    poses = np.zeros((len(time), 7))
    poses[:, :3] = np.cumsum(rng.normal(0, 1e-5, (len(time), 3)), axis=0)
    poses[:, 6] = 1.0
    poses[65_540:, 0] += 0.2
    poses[80_000, 1] += 0.5
    poses[68_000:69_500] = poses[68_000]
    widths = (0.04 + 0.01 * np.sin(time * 1e-9)).astype(np.float32)
    widths[65_536] += 0.02
    path = tmp_path_factory.mktemp("defective") / "e.zarr"
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        frames = Frames(parent="world", child="gripper")
        pose = writer.add_stream(
            "pose", kind="pose", clock=HOST, frames=frames, nominal_rate="1000",
            time_device_unit="ns",
        )  # fmt: skip
        pose.append(time, poses, sequence=sequence, time_device=device)
        width = writer.add_stream("width", kind="width", clock=HOST)
        width.append(time, widths)
    return path


def judged(path: Path) -> tuple[list[tuple[str, str, int | None, str]], list[tuple[str, str]]]:
    report = validate(path, levels=["hierarchy", "arrays"])
    problems = [(p.code, p.location.path, p.location.index, p.message) for p in report.problems]
    return problems, [(item.code, item.reason) for item in report.coverage.skipped]


def test_chunks_do_not_change_the_verdict(defective: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = judged(defective)
    codes = {code for code, *_ in expected[0]}
    assert codes >= {"TIME-005", "TIME-006", "SEQ-002", "CLOCK-005", "POSE-004", "WIDTH-005"}
    for rows in CHUNK_ROWS:
        assert judged(rechunked(defective, rows)) == expected, rows
    for block in (1 << 16, 1 << 24):
        monkeypatch.setattr(context, "_BLOCK_BYTES", block)
        assert judged(defective) == expected, block
