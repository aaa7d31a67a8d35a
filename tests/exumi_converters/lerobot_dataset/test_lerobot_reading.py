"""Datasets that somebody else wrote: cut videos, mapped numbers, and nothing guessed."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from exumi_converters import ConvertOptions, convert, plan_conversion
from exumi_converters.registry import find_converter
from exumi_converters.testing import check_converter
from exumi_data.dataset import Dataset, open_dataset
from exumi_data.episode import Episode
from exumi_data.errors import SourceError, UsageError
from exumi_validators import validate
from tests.exumi_converters.lerobot_dataset.theirs import (
    EPISODES,
    FRONT,
    GEL,
    HEIGHT,
    NAMES,
    ROWS,
    WIDTH,
    Theirs,
    edit_info,
    edit_rows,
    level,
    states,
    write_theirs,
)

Read = Callable[..., tuple[Any, dict[str, Episode]]]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read(source: Path, **settings: str) -> tuple[Any, dict[str, Episode]]:
        options = ConvertOptions(workers=1, durable=False, settings=settings)
        report = convert(source, tmp_path / "read", options=options)
        return report, by_key(open_dataset(tmp_path / "read"))

    return read


def by_key(dataset: Dataset) -> dict[str, Episode]:
    return {str(episode.metadata.source.key): episode for episode in dataset}


def check_pictures(episode: Episode, number: int, stream: str = "front") -> None:
    frames = episode[stream].frames
    for index in range(len(frames)):
        found = float(frames[index][..., 1].mean())
        assert abs(found - (level(number, index) + 4)) < 1.2, (number, index)


def test_the_contract(tmp_path: Path) -> None:
    source = write_theirs(tmp_path / "theirs")
    settings = {"tactile": GEL}
    options = ConvertOptions(durable=False, settings=settings)
    check_converter(find_converter("lerobot"), source, tmp_path / "made", options)
    report = validate(tmp_path / "made" / "first")
    assert not [p for p in report.problems if p.severity == "error"]


def test_shared_videos_are_cut_at_keyframes_without_decoding(tmp_path: Path, read: Read) -> None:
    source = write_theirs(tmp_path / "theirs")
    report, episodes = read(source, tactile=GEL, frames="world/tcp")
    assert not report.failed
    assert sorted(episodes) == ["episode_000000", "episode_000001", "episode_000002"]
    for number, episode in enumerate(episodes[key] for key in sorted(episodes)):
        count = Theirs().lengths[number]
        assert {name: s.kind for name, s in episode.streams.items()} == {
            "front": "rgb",
            "gel": "tactile",
            "pose": "pose",
            "grip": "width",
        }
        assert all(len(stream) == count for stream in episode.streams.values())
        assert episode["front"].metadata.images.encoding == "video"  # type: ignore[attr-defined]
        check_pictures(episode, number)
        check_pictures(episode, number, "gel")
        clock = episode["pose"].metadata.clock
        assert (clock.stamp_point, clock.source) == ("nominal_rate", "none")
        expected = states(number, count)
        np.testing.assert_allclose(episode["pose"].data, expected[:, :7], atol=1e-6)
        np.testing.assert_allclose(episode["grip"].data, expected[:, 7], atol=1e-7)
        np.testing.assert_allclose(episode["pose"].time, np.arange(count) / 30 * 1e9, atol=1)
        assert episode["pose"].metadata.frames.parent == "world"  # type: ignore[attr-defined]
        text = ("lift the cup", "put it down")[number % 2]
        assert (episode.metadata.task.name, episode.metadata.task.instruction) == (text, text)
        assert episode.metadata.device is not None
        assert episode.metadata.device.name == "so100"
        assert episode["gel"].activity is not None
        notes = [n.message for n in episode.metadata.quality if n.code == "not-converted"]
        assert notes == ["features that were not read: action (actions are no measurements)"]


def test_frames_that_lean_on_other_episodes_become_jpegs_and_that_is_said(
    tmp_path: Path, read: Read
) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(gop=None))
    _, episodes = read(source)
    encodings = [episodes[k]["front"].metadata.images.encoding for k in sorted(episodes)]  # type: ignore[attr-defined]
    # The first begins with a keyframe, and ends with frames made from one of the second.
    assert encodings == ["encoded", "encoded", "encoded"]
    for number, key in enumerate(sorted(episodes)):
        check_pictures(episodes[key], number)
    lossy = episodes["episode_000001"].metadata.source.lossy or []
    assert {step.stream for step in lossy if step.step == "jpeg-encode"} == {"front", "gel"}


def test_a_file_of_its_own_is_kept_byte_for_byte(tmp_path: Path, read: Read) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(lengths=(14,)))
    _, episodes = read(source)
    file = source / f"videos/{FRONT}/chunk-000/file-000.mp4"
    assert episodes["episode_000000"]["front"].container(0) == file.read_bytes()
    check_pictures(episodes["episode_000000"], 0)


@pytest.mark.parametrize(
    ("names", "settings", "columns"),
    [
        (None, {"pose": "observation.state:0:xyzw"}, [3, 4, 5, 6]),
        (None, {"pose": "observation.state:0:wxyz"}, [4, 5, 6, 3]),
        ([f"motor_{i}" for i in range(8)], {"pose": "observation.state:0:xyzw"}, [3, 4, 5, 6]),
    ],
)
def test_an_option_says_what_names_do_not(
    tmp_path: Path, read: Read, names: Any, settings: dict[str, str], columns: list[int]
) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(names=names, lengths=(10,)))
    _, episodes = read(source, width="observation.state:7", **settings)
    episode = episodes["episode_000000"]
    values = states(0, 10)[:, columns].astype(np.float64)
    values /= np.linalg.norm(values, axis=1, keepdims=True)
    np.testing.assert_allclose(episode["pose"].data[:, 3:], values, atol=1e-6)
    np.testing.assert_allclose(episode["width"].data, 0.05, atol=1e-7)


def test_a_rotation_vector_becomes_a_quaternion(tmp_path: Path, read: Read) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(names=None, lengths=(10,)))
    _, episodes = read(source, pose="observation.state:0:rotvec")
    pose = episodes["episode_000000"]["pose"].data
    angle = states(0, 10)[:, 5].astype(np.float64)  # around z, in the columns of the vector
    np.testing.assert_allclose(pose[:, 5], np.sin(angle / 2), atol=1e-6)
    np.testing.assert_allclose(pose[:, 6], np.cos(angle / 2), atol=1e-6)


@pytest.mark.parametrize(
    "names",
    [
        None,
        [f"joint_{i}" for i in range(8)],
        ["x", "y", "z", "x", "qx", "qy", "qz", "qw"],  # whose x?
        ["x", "y", "z", "q0", "q1", "q2", "q3", "gripper"],
        {"motors": ["a", "b"]},
    ],
)
def test_nothing_is_guessed(tmp_path: Path, read: Read, names: Any) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(names=names, lengths=(10,)))
    report, episodes = read(source)
    assert set(episodes["episode_000000"].streams) == {"front", "gel"}
    said = [line for line in report.notices if "observation.state" in line]
    assert len(said) == 1
    assert "nothing says what they are" in said[0]


def test_names_in_a_table_of_motors_are_names(tmp_path: Path, read: Read) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(names={"motors": NAMES}, lengths=(10,)))
    _, episodes = read(source)
    assert {"pose", "grip"} <= set(episodes["episode_000000"].streams)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pose": "observation.state:0"}, r"Invalid pose .*Orders are xyzw, wxyz, rotvec"),
        ({"pose": "observation.state:2:xyzw"}, r"7 column\(s\) of a feature are needed"),
        ({"pose": "state:0:xyzw"}, "observation.state of 8"),
        ({"width": "observation.state:8"}, "1 column"),
        ({"tactile": "gel"}, "no such image feature"),
        ({"frames": "world"}, "<parent>/<child>"),
    ],
)
def test_options_that_name_nothing_are_refused(
    tmp_path: Path, settings: dict[str, str], message: str
) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(lengths=(10,)))
    with pytest.raises(UsageError, match=message):
        plan_conversion(source, options=ConvertOptions(settings=settings))


def test_pictures_in_the_table_are_kept_without_loss(tmp_path: Path, read: Read) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(videos=(), lengths=(6, 7)))
    rng = np.random.default_rng(1)
    truth = rng.integers(0, 255, (13, HEIGHT, WIDTH, 3)).astype(np.uint8)
    table = pq.read_table(source / ROWS)
    png = [cv2.imencode(".png", frame[..., ::-1])[1].tobytes() for frame in truth]
    jpg = [cv2.imencode(".jpg", frame[..., ::-1])[1].tobytes() for frame in truth]
    for name, files in (("wrist", png), ("top", jpg)):
        column = pa.array([{"bytes": file, "path": None} for file in files])
        table = table.append_column(f"observation.images.{name}", column)
        _add_feature(source, name)
    pq.write_table(table, source / ROWS)
    _, episodes = read(source)
    second = episodes["episode_000001"]
    np.testing.assert_array_equal(second["wrist"].frames[:], truth[6:])
    assert second["top"].encoded(3) == jpg[9]


def _add_feature(source: Path, name: str) -> None:
    edit_info(source, lambda info: info["features"].update(_image(name)))


def _image(name: str) -> dict[str, Any]:
    shape = [HEIGHT, WIDTH, 3]
    return {f"observation.images.{name}": {"dtype": "image", "shape": shape, "names": None}}


def test_tasks_that_change_within_an_episode_become_segments(tmp_path: Path, read: Read) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(lengths=(9,)))

    def half(rows: list[dict[str, Any]]) -> None:
        for row in rows[5:]:
            row["task_index"] = 1

    edit_rows(source, half)
    edit_rows(source, lambda rows: rows[0]["tasks"].append("put it down"), EPISODES)
    _, episodes = read(source)
    annotations = episodes["episode_000000"].metadata.annotations
    assert annotations is not None
    said = [(s.name, s.start_ns, s.end_ns) for s in annotations.segments or []]
    assert said == [("lift the cup", 0, 166_666_666), ("put it down", 166_666_667, 300_000_000)]


def test_values_that_are_none_are_left_out_as_gaps(tmp_path: Path, read: Read) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(lengths=(10,)))

    def spoil(rows: list[dict[str, Any]]) -> None:
        rows[3]["observation.state"][0] = float("nan")
        rows[6]["observation.state"][5] = rows[6]["observation.state"][6] = 0.0

    edit_rows(source, spoil)
    _, episodes = read(source)
    episode = episodes["episode_000000"]
    assert (len(episode["pose"]), len(episode["grip"]), len(episode["front"])) == (8, 10, 10)
    assert [(g.after, g.lost) for g in episode["pose"].metadata.gaps or []] == [(2, 1), (4, 1)]
    assert "dropped" in {note.code for note in episode.metadata.quality}


def test_older_versions_are_sent_to_lerobots_own_script(tmp_path: Path) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(lengths=(10,)))
    edit_info(source, lambda info: info.update(codebase_version="v2.1"))
    with pytest.raises(SourceError, match=r"version 'v2.1'; v3.0 is read.*convert_dataset_v21"):
        plan_conversion(source)


def test_what_exumi_declared_is_used_only_where_it_can_be_read(tmp_path: Path) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(lengths=(10,)))
    for text in ("{", json.dumps({"format": "exumi-lerobot", "streams": 3}), "[" * 100_000):
        (source / "meta/exumi.json").write_text(text)
        notices = plan_conversion(source).notices
        assert any("what exUMI declared is not used" in line for line in notices)


def test_a_png_that_claims_too_many_pixels_is_not_decoded(tmp_path: Path) -> None:
    source = write_theirs(tmp_path / "theirs", Theirs(videos=(), lengths=(4,)))
    file = bytearray(cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes())
    file[16:24] = (60_000).to_bytes(4, "big") * 2
    table = pq.read_table(source / ROWS)
    column = pa.array([{"bytes": bytes(file), "path": None}] * 4)
    buffer = io.BytesIO()
    pq.write_table(table.append_column("observation.images.top", column), buffer)
    (source / ROWS).write_bytes(buffer.getvalue())
    _add_feature(source, "top")
    report = convert(source, tmp_path / "read", options=ConvertOptions(workers=1, durable=False))
    assert "claims 60000x60000 pixels" in report.failed[0].reason
