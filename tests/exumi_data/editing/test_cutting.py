"""Cutting: what stays is the same, value by value and byte by byte; only time counts anew."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.editing.cutting import Stretch, cut_annotations, cut_gaps, cut_stream
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import UnsupportedError
from exumi_data.model import (
    Annotations,
    Clock,
    EncodedImages,
    Frames,
    Gap,
    RawData,
    Segment,
    VideoImages,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import apply_clock
from exumi_validators import validate
from tests.exumi_data.builders import clip, edit_metadata, metadata, pictures, video_file

HOST = 4_000_000_000_000
N = 500
TIME = np.arange(N, dtype=np.int64) * 10_000_000 + np.random.default_rng(1).integers(0, 999, N)
STRETCH = Stretch(1_000_000_000, 2_500_000_000, 1_200_000_000)
FIRST, LAST = (int(at) for at in np.searchsorted(TIME, [STRETCH.first_ns, STRETCH.stop_ns]))


def write_session(path: Path) -> Path:
    rng = np.random.default_rng(2)
    with EpisodeWriter(path, metadata(start="2026-03-01T23:59:59.5Z"), durable=False) as writer:
        drifting = Clock(
            source="hub_monotonic",
            stamp_point="kernel_rx",
            t_ref_ns=HOST,
            drift_ppm=17.25,
            offset_ns=-400,
            latency_ns=3_000_000,
            raw_time="time_host",
        )
        host = TIME + HOST + 3_000_000
        pose = writer.add_stream(
            "pose",
            kind="pose",
            clock=drifting,
            frames=Frames(parent="world", child="tcp"),
            gaps=[Gap(after=3), Gap(after=FIRST - 1, lost=2), Gap(after=FIRST + 9, lost=4)],
            lost={"kernel": 6},
        )
        poses = np.hstack([rng.normal(size=(N, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (N, 1))])
        flags = np.zeros(N, np.uint32)
        flags[FIRST] = 4
        pose.append(
            apply_clock(host, t_ref=HOST, drift_ppm=17.25, offset_ns=-400, latency_ns=3_000_000),
            poses,
            time_host=host,
            sequence=np.arange(N, dtype=np.uint64) + 7,
            flags=flags,
        )
        plain = Clock(
            source="hub_monotonic", stamp_point="bracket_mid", t_ref_ns=HOST, raw_time="time_host"
        )
        width = writer.add_stream("width", kind="width", clock=plain, raw=RawData(unit="count"))
        width.append(
            TIME,
            rng.random(N) * 0.05,
            raw=rng.integers(0, 4096, N).astype(np.uint16),
            time_host=TIME + HOST,
        )
        taxels = writer.add_stream(
            "taxels", kind="taxels", clock=plain, grid=[2, 3], unit="count", nominal_rate="100"
        )
        taxels.append(
            TIME, rng.integers(0, 3500, (N, 2, 3)).astype(np.int16), time_host=TIME + HOST
        )
        taxels.set_valid(np.array([[True, False, True], [True, True, True]]))
        images = EncodedImages(
            encoding="encoded", media_type="image/jpeg", height=24, width=32, channels=3
        )
        tactile = writer.add_stream("tactile", kind="tactile", clock=plain, images=images)
        noise = rng.integers(0, 60, (N, 24, 32, 3), dtype=np.uint8)
        files = [jpeg.encode(picture, 90) for picture in noise]
        tactile.append(TIME, files, time_host=TIME + HOST)
        tactile.set_reference(pictures(1)[0], method="selected", frames=[FIRST + 2, FIRST + 4])
    return path


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Episode:
    return open_episode(write_session(tmp_path_factory.mktemp("session") / "s.zarr"))


@pytest.fixture(scope="module")
def cut(session: Episode, tmp_path_factory: pytest.TempPathFactory) -> Episode:
    path = tmp_path_factory.mktemp("cut") / "c.zarr"
    with EpisodeWriter(path, metadata(1), durable=False) as writer:
        for name in session:
            cut_stream(session, name, writer, STRETCH)
    return open_episode(path)


@pytest.mark.parametrize("name", ["pose", "width", "taxels", "tactile"])
def test_samples_are_those_of_the_session(session: Episode, cut: Episode, name: str) -> None:
    before, after = session[name], cut[name]
    first, last = np.searchsorted(before.time, [STRETCH.first_ns, STRETCH.stop_ns])
    assert len(after) == last - first > 100
    assert (after.time + STRETCH.origin_ns == before.time[first:last]).all()
    assert after.metadata.arrays == before.metadata.arrays
    for array in set(before.metadata.arrays) - {"time", "data", "offset", "crc32c"}:
        whole = before.array(array)
        expected = whole if array in ("valid", "reference") else whole[first:last]
        assert after.array(array).dtype == expected.dtype
        assert (after.array(array) == expected).all()
    if name != "tactile":
        assert (after.data == before.data[first:last]).all()


def test_image_files_are_the_same_bytes(session: Episode, cut: Episode) -> None:
    view = cut["tactile"]
    assert [view.encoded(i) for i in range(len(view))] == [
        session["tactile"].encoded(i) for i in range(FIRST, LAST)
    ]


@pytest.mark.parametrize("name", ["pose", "width"])
def test_the_clock_still_explains_the_times(cut: Episode, name: str) -> None:
    view = cut[name]
    clock = view.metadata.clock
    assert view.time_host is not None
    again = apply_clock(
        view.time_host,
        t_ref=clock.t_ref_ns,
        drift_ppm=clock.drift_ppm,
        offset_ns=clock.offset_ns,
        latency_ns=clock.latency_ns,
    )
    assert (again == view.time).all()


def test_what_is_said_of_the_samples_follows_them(session: Episode, cut: Episode) -> None:
    start = int(np.searchsorted(session["pose"].time, STRETCH.first_ns))
    gaps = cut["pose"].metadata.gaps
    shift = FIRST - start
    assert gaps == [Gap(after=shift - 1), Gap(after=shift + 9, lost=4)]
    assert cut["pose"].metadata.lost is None
    reference = cut["tactile"].metadata.reference  # type: ignore[attr-defined]  # it is tactile
    assert reference.frames == [2, 4]
    assert reference.method == "selected"


def test_the_cut_episode_is_valid(cut: Episode) -> None:
    problems = validate(cut.path).problems
    assert [p.rule for p in problems if p.severity == "error"] == []


def test_blocks_are_bounded_and_make_the_same(
    session: Episode, cut: Episode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("exumi_data.editing.cutting._BLOCK_ROWS", 7)
    path = tmp_path / "c.zarr"
    with EpisodeWriter(path, metadata(1), durable=False) as writer:
        for name in session:
            cut_stream(session, name, writer, STRETCH)
    with open_episode(path) as again:
        assert again.digest() == cut.digest()


def test_a_stretch_without_samples(session: Episode, tmp_path: Path) -> None:
    path = tmp_path / "c.zarr"
    with EpisodeWriter(path, metadata(1), durable=False) as writer:
        for name in session:
            assert cut_stream(session, name, writer, Stretch(10**12, 2 * 10**12, 10**12)) == 0
    with open_episode(path) as empty:
        assert [len(stream) for stream in empty.streams.values()] == [0, 0, 0, 0]
        errors = [p.rule for p in validate(empty.path).problems if p.severity == "error"]
        assert errors == []


def gap(after: int, lost: int | None = None) -> Gap:
    return Gap(after=after, lost=lost, reason="x")


@pytest.mark.parametrize(
    ("gaps", "kept"),
    [
        (None, None),
        ([], None),
        ([gap(8, 1)], None),
        ([gap(9, 2)], [gap(-1)]),  # it reaches in; how much of it is not known
        ([gap(10, 2), gap(18, 3)], [gap(0, 2), gap(8, 3)]),
        ([gap(19, 2)], [gap(9)]),
        ([gap(20, 2)], None),
    ],
)
def test_gaps_at_the_edges(gaps: list[Gap] | None, kept: list[Gap] | None) -> None:
    assert cut_gaps(gaps, 10, 20) == kept


def test_segments_are_cut() -> None:
    whole = Annotations(
        object="a cup",
        segments=[
            Segment(name="before", start_ns=0, end_ns=900),
            Segment(name="into", start_ns=500, end_ns=1500),
            Segment(name="inside", start_ns=1500, end_ns=1800),
            Segment(name="after", start_ns=2000, end_ns=2500),
        ],
    )
    cut = cut_annotations(whole, Stretch(1000, 2000, 1000))
    assert cut is not None
    assert cut.object == "a cup"
    assert [(s.name, s.start_ns, s.end_ns) for s in cut.segments or []] == [
        ("into", 0, 500),
        ("inside", 500, 800),
    ]
    assert cut_annotations(None, STRETCH) is None


def test_video_of_the_session_keeps_whole_files(tmp_path: Path) -> None:
    content, pts, keyframe, base = clip()
    path = tmp_path / "s.zarr"
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        fields: dict[str, Any] = {
            "images": VideoImages(encoding="video", height=24, width=32, channels=3)
        }
        stream = writer.add_stream("front", kind="rgb", **fields)
        for number in range(4):
            file = video_file(content, base, f"front_{number}.mp4")
            file.start_ns = number * 1_000_000_000
            stream.append_file(content, file, pts=np.array(pts), keyframe=np.array(keyframe))
    target = tmp_path / "c.zarr"
    with open_episode(path) as session:
        whole = session["front"]
        middle = len(pts)
        stretch = Stretch(
            int(whole.time[middle + 1]), int(whole.time[2 * middle]) + 1, int(whole.time[middle])
        )
        with EpisodeWriter(target, metadata(1), durable=False) as writer:
            assert cut_stream(session, "front", writer, stretch) == 2 * middle
        with open_episode(target) as cut:
            view = cut["front"]
            assert [view.container(i) for i in (0, 1)] == [content, content]
            assert (view.time + stretch.origin_ns == whole.time[middle : 3 * middle]).all()
            assert (view.frames[middle] == whole.frames[2 * middle]).all()
            assert [p.rule for p in validate(target).problems if p.severity == "error"] == []


def test_arrays_of_a_third_party_are_not_cut_blindly(tmp_path: Path) -> None:
    path = write_session(tmp_path / "s.zarr")
    edit_metadata(path, lambda m: m["streams"]["width"]["arrays"].append("exposure"))
    with (
        open_episode(path) as session,
        pytest.raises(UnsupportedError, match=r"exposure.*--without width"),
        EpisodeWriter(tmp_path / "c.zarr", metadata(1), durable=False) as writer,
    ):
        cut_stream(session, "width", writer, STRETCH)
