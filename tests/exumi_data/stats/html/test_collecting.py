"""What is taken from episodes: numbers that can be worked out by hand."""

import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.dataset import Dataset
from exumi_data.episode import open_episode
from exumi_data.stats.html.collecting import collect_figures, collect_pictures, locations
from exumi_data.stats.html.figures import PoseFigures
from exumi_data.stats.html.looking import GRID
from exumi_data.stats.html.reading import even, read_figures
from exumi_data.stats.html.totals import PoseTotal
from exumi_data.store.images import ArrayFrames
from tests.exumi_data.stats.html.conftest import FRAMES, write_touch


def test_figures_of_an_episode(touched: Dataset) -> None:
    figures = read_figures(touched[0])
    left = figures.touches[0]
    assert (sum(left.frames), sum(left.active)) == (FRAMES, 4)
    assert left.peak == pytest.approx(0.13)
    assert left.active.index(1) == 22  # the fifth of eight frames, of 40 steps
    width, force, torque = (
        next(v for v in figures.values if v.component == name) for name in ("width", "fz", "tz")
    )
    assert (width.counts, width.left_out) == ({0: 1, 100: 2, 200: 3, 800: 1}, 1)
    assert (force.unit, torque.unit) == ("N", "N·m")
    assert force.counts == {0: 4, 500: 1, 1000: 1, 1500: 1, 2000: 1}
    (pose,) = figures.poses
    assert pose.left_out == 1  # flagged as not valid
    assert pose.from_above == {(n, 0): 1 for n in range(0, 35, 5)}
    assert pose.from_side == {(n, 30): 1 for n in range(0, 35, 5)}
    assert pose.tilts == {0: 7}
    assert list(pose.low) == pytest.approx([0.005, pose.low[1], 0.305])
    assert list(pose.high) == pytest.approx([0.305, pose.low[1], 0.305])
    assert list(pose.tilt_ends) == [0, 0]
    assert dict(figures.numbers)["hardness"] == pytest.approx(2.0, abs=3)


def test_the_tilt_is_the_angle_between_the_z_axes(tmp_path: Path) -> None:
    from exumi_data.stats.html.reading import _tilt_deg

    half = np.radians(60) / 2
    poses = np.array([[0, 0, 0, np.sin(half), 0, 0, np.cos(half)], [0, 0, 0, 0, 1, 0, 0.0]])
    assert _tilt_deg(poses) == pytest.approx([60, 180], abs=0.01)


def test_where_fingers_are_touched(touched: Dataset) -> None:
    paths = locations(touched)
    pictures = collect_pictures(paths, collect_figures(paths))
    assert sorted(pictures.maps) == ["tactile_left", "tactile_right"]
    for name, columns in (("tactile_left", slice(8, 32)), ("tactile_right", slice(64, 88))):
        found = pictures.maps[name]
        assert found.frames == 12  # four of each episode
        row, column = np.unravel_index(found.counts.argmax(), found.counts.shape)
        assert 20 / 64 <= row / GRID <= 44 / 64
        assert columns.start / 96 <= column / GRID <= columns.stop / 96
        assert found.counts.max() == 12 * (224 // GRID) ** 2
        assert found.counts[0].sum() == 0
    assert len(pictures.tiles) == 3
    tile = pictures.tiles[0]
    assert tile.activity == pytest.approx(0.13)
    assert tile.time_s == pytest.approx(0.7)
    assert [p.words for p in tile.pictures] == [
        "rgb", "tactile_left", "tactile_left, change", "tactile_right", "tactile_right, change",
    ]  # fmt: skip


def test_no_frame_is_decoded_twice(touched: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: Counter[tuple[int, int]] = Counter()
    really = ArrayFrames.read_into

    def count(self: ArrayFrames, index: int, out: np.ndarray) -> None:
        decoded[id(self._data), index] += 1
        alive.append(self)  # so that no other gets its id
        really(self, index, out)

    alive: list[ArrayFrames] = []
    monkeypatch.setattr(ArrayFrames, "read_into", count)
    paths = locations(touched)
    pictures = collect_pictures(paths, collect_figures(paths))
    assert set(decoded.values()) == {1}
    assert sum(decoded.values()) == pictures.decoded + 3  # and a camera frame an episode
    assert pictures.decoded == 24


def test_without_stored_activity_contact_is_found_in_the_frames(tmp_path: Path) -> None:
    path = write_touch(tmp_path, 7, activity=False)
    totals = collect_figures([str(path)])
    assert totals.without_activity == {"tactile_left": 1, "tactile_right": 1}
    pictures = collect_pictures([str(path)], totals)
    assert pictures.maps["tactile_left"].frames == 4
    assert pictures.tiles[0].time_s == pytest.approx(0.5)  # the first of the equally large ones


def test_without_a_reference_the_middle_is_shown_without_change(tmp_path: Path) -> None:
    path = write_touch(tmp_path, 8, activity=False, reference=False)
    totals = collect_figures([str(path)])
    pictures = collect_pictures([str(path)], totals)
    assert pictures.maps == {}
    assert [p.words for p in pictures.tiles[0].pictures] == ["rgb", "tactile_left", "tactile_right"]
    assert totals.without_reference == {"tactile_left": 1, "tactile_right": 1}


def test_what_cannot_be_read_is_named(touched: Dataset, tmp_path: Path) -> None:
    path = write_touch(tmp_path, 9)
    shutil.rmtree(path / "streams" / "width" / "data" / "c")
    totals = collect_figures([str(path), *locations(touched)])
    assert [item.path for item in totals.unreadable] == [str(path)]
    assert len(totals.rows) == 3
    other = write_touch(tmp_path, 10)
    shutil.rmtree(other / "streams" / "tactile_left" / "data" / "c")
    totals = collect_figures([str(other)])
    assert not totals.unreadable
    assert [item.path for item in collect_pictures([str(other)], totals).damaged] == [str(other)]


def test_processes_give_the_same(touched: Dataset) -> None:
    paths = locations(touched)
    done: list[tuple[int, int]] = []
    alone = collect_figures(paths, workers=1, on_progress=lambda *step: done.append(step))
    assert done == [(1, 3), (2, 3), (3, 3)]
    both = collect_figures(paths, workers=2)
    assert [row.id for row in both.rows] == [row.id for row in alone.rows]
    assert both.values == alone.values
    assert list(both.by_group) == list(alone.by_group)
    few, many = (collect_pictures(paths, alone, workers=n) for n in (1, 2))
    assert few.tiles == many.tiles
    assert (few.maps["tactile_left"].counts == many.maps["tactile_left"].counts).all()


def pose_figures(**changes: Any) -> PoseFigures:
    nothing: dict[str, Any] = {"from_above": {}, "from_side": {}, "tilts": {}, "left_out": 0}
    ends: dict[str, Any] = {"low": (), "high": (), "tilt_ends": ()}
    return PoseFigures(stream="p", parent="world", child="tcp", **nothing | ends | changes)


def test_ends_of_poses_are_exact() -> None:
    total = PoseTotal("world", "tcp")
    total.add(pose_figures(left_out=2))
    assert (total.low, total.tilt_ends) == ((), ())
    total.add(pose_figures(low=(0.001, 1, 2), high=(0.002, 1, 2), tilt_ends=(4.0, 7.0)))
    total.add(pose_figures(low=(-0.5, 1, 2.5), high=(-0.4, 1.25, 3), tilt_ends=(5.0, 9.5)))
    assert (total.low, total.high) == ((-0.5, 1, 2), (0.002, 1.25, 3))
    assert total.tilt_ends == (4.0, 9.5)
    assert (total.episodes, total.left_out) == (3, 2)


def test_cells_become_coarser_where_there_are_too_many() -> None:
    total = PoseTotal("world", "tcp")
    for block in range(5):
        cells = {(x, y + 100 * block): 1 for x in range(200) for y in range(100)}
        total.add(pose_figures(from_above=cells))
    assert total.cell_m == pytest.approx(0.02)
    assert len(total.from_above) == 200 * 500 // 4
    assert sum(total.from_above.values()) == 200 * 500


def test_evenly_spread_positions() -> None:
    assert even(3, 5).tolist() == [0, 1, 2]
    assert even(10, 2).tolist() == [2, 7]
    assert even(10**12, 3).tolist() == [166666666666, 500000000000, 833333333333]
    assert even(5, 0).tolist() == []


def test_an_episode_without_streams_is_no_trouble(tmp_path: Path, touched: Dataset) -> None:
    from exumi_data.store.episode_writer import EpisodeWriter

    path = tmp_path / "empty.zarr"
    meta = touched[0].metadata.model_copy(update={"streams": {}})
    with EpisodeWriter(path, meta, durable=False):
        pass
    with open_episode(path) as episode:
        assert read_figures(episode).duration_s == 0
    totals = collect_figures([str(path)])
    assert collect_pictures([str(path)], totals).tiles == []
