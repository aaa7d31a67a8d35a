"""What is appended is stored as it is, or refused whole: arrays never lose step with each other."""

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_data.episode import StreamView, open_episode
from exumi_data.errors import ExumiError, UsageError
from exumi_data.model import Clock, Frames, VideoImages
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_data.builders import (
    CLOCK,
    HEIGHT,
    WIDTH,
    array_images,
    clip,
    encoded_images,
    jpegs,
    metadata,
    pictures,
    video_file,
)

OTHER = {"extension_version": "1", "schema_url": "https://acme.example/1"}


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[EpisodeWriter]:
    with EpisodeWriter(tmp_path / "a.zarr", metadata(), durable=False) as writer:
        yield writer


def finished(writer: EpisodeWriter, name: str = "s") -> StreamView:
    return open_episode(writer.finish())[name]


def width(writer: EpisodeWriter) -> Any:
    return writer.add_stream("s", kind="width", clock=CLOCK)


# ---------------------------------------------------------------------------------------- appending


@settings(max_examples=30)
@given(
    cuts=st.lists(st.integers(0, 20), max_size=6),
    start=st.integers(-(2**63), 2**63 - 21 * 2**40),
    steps=st.lists(st.integers(1, 2**40), min_size=20, max_size=20),
)
def test_samples_are_kept_in_any_portions(
    tmp_path_factory: pytest.TempPathFactory, cuts: list[int], start: int, steps: list[int]
) -> None:
    time = np.array([start + sum(steps[:i]) for i in range(20)], dtype=np.int64)
    values = np.arange(20, dtype=np.float32)
    path = tmp_path_factory.mktemp("portions") / "a.zarr"
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        stream = width(writer)
        edges = [0, *sorted(cuts), 20]
        for first, last in pairwise(edges):
            part = slice(first, last)
            stream.append(
                time[part], values[part], time_device=time[part], sequence=range(20)[part]
            )
    view = open_episode(path)["s"]
    np.testing.assert_array_equal(view.time, time)
    np.testing.assert_array_equal(view.data, values)
    np.testing.assert_array_equal(view.time_device, time)
    np.testing.assert_array_equal(view.sequence, np.arange(20))
    assert view.sequence is not None
    assert view.sequence.dtype == np.uint64


def test_one_sample_at_a_time(writer: EpisodeWriter) -> None:
    stream = width(writer)
    for index in range(5):
        stream.append(index * 10, 0.5, raw=index, time_host=index, sequence=index, flags=0)
    view = finished(writer)
    assert view.time.tolist() == [0, 10, 20, 30, 40]
    assert view.raw is not None
    assert view.raw.tolist() == [0, 1, 2, 3, 4]
    assert view.flags is not None
    assert view.flags.dtype == np.uint32


def test_a_stream_without_samples_has_all_its_arrays(writer: EpisodeWriter) -> None:
    kinds: dict[str, dict[str, Any]] = {
        "pose": {"frames": Frames(parent="world", child="tcp")},
        "width": {},
        "wrench": {"components": ["fx", "fy"]},
        "taxels": {"grid": [2, 3], "unit": "adc"},
        "rgb": {"images": array_images()},
        "tactile": {"images": encoded_images()},
        "acme:x": OTHER,
        "audio": {"rate": "48000", "channels": 2},
    }
    for number, (kind, fields) in enumerate(kinds.items()):
        writer.add_stream(f"s{number}", kind=kind, clock=CLOCK, **fields)
    episode = open_episode(writer.finish())
    shapes = [episode[f"s{number}"].array("data").shape for number in range(len(kinds))]
    assert shapes == [(0, 7), (0,), (0, 2), (0, 2, 3), (0, HEIGHT, WIDTH, 3), (0,), (0,), (0, 2)]
    assert len(episode["s4"].frames) == len(episode["s5"].frames) == 0
    assert episode["s5"].frames[:].shape == (0, HEIGHT, WIDTH, 3)
    assert episode.duration_s == 0


def test_an_empty_portion_decides_what_comes_with_every_sample(writer: EpisodeWriter) -> None:
    stream = width(writer)
    stream.append([], [], time_host=[])
    with pytest.raises(UsageError, match="with every sample or with none"):
        stream.append(0, 0.1)
    stream.append(0, 0.1, time_host=7)
    assert finished(writer).metadata.arrays == ["time", "time_host", "data"]


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_files_come_as_any_bytes(writer: EpisodeWriter, kind: Callable[[bytes], Any]) -> None:
    stream = writer.add_stream("s", kind="rgb", clock=CLOCK, images=encoded_images())
    stream.append(0, kind(jpegs()[0]))
    stream.append([1, 2], [kind(file) for file in jpegs()[1:3]])
    view = finished(writer)
    assert [view.encoded(i) for i in (0, 1, -1)] == list(jpegs()[:3])


# ------------------------------------------------------------------------------------------- errors


BAD_TIMES: list[Any] = [
    [20, 20],
    [20, 15],
    10,  # the last one, again
    5,
    [[20, 21]],
    [20.0, 21.0],
    ["20", "21"],
    True,
    [None, 3],
    2**63,
    [20, 2**63],
    np.array([20, 2**63 + 5], np.uint64),
    [-(2**62) * 2, 2**62],  # their difference does not fit into 64 bits
]


@pytest.mark.parametrize("time", BAD_TIMES, ids=str)
def test_times_that_do_not_increase_or_are_none(writer: EpisodeWriter, time: Any) -> None:
    stream = width(writer)
    stream.append([0, 10], [0.0, 0.1])
    with pytest.raises(UsageError):
        stream.append(time, np.zeros(np.size(time)) if np.ndim(time) else 0.0)
    stream.append(30, 0.3)
    view = finished(writer)
    assert view.time.tolist() == [0, 10, 30]
    np.testing.assert_allclose(view.data, [0, 0.1, 0.3], rtol=1e-6)


def test_the_sample_that_does_not_increase_is_named(writer: EpisodeWriter) -> None:
    stream = width(writer)
    stream.append([0, 10], [0, 0])
    with pytest.raises(UsageError, match="time does not increase at sample 4"):
        stream.append([20, 30, 30, 20], np.zeros(4))
    with pytest.raises(UsageError, match="time does not increase at sample 2"):
        stream.append([10, 30], np.zeros(2))


def pose(writer: EpisodeWriter) -> tuple[Any, Any]:
    frames = Frames(parent="world", child="tcp")
    stream = writer.add_stream("s", kind="pose", clock=CLOCK, frames=frames)
    return stream, lambda n: np.ones((n, 7))


def rgb(writer: EpisodeWriter) -> tuple[Any, Any]:
    stream = writer.add_stream("s", kind="rgb", clock=CLOCK, images=array_images())
    return stream, pictures


def taxels(writer: EpisodeWriter) -> tuple[Any, Any]:
    stream = writer.add_stream("s", kind="taxels", clock=CLOCK, grid=[2, 3], unit="adc")
    return stream, lambda n: np.ones((n, 2, 3), np.int16)


def files(writer: EpisodeWriter) -> tuple[Any, Any]:
    stream = writer.add_stream("s", kind="rgb", clock=CLOCK, images=encoded_images())
    return stream, lambda n: list(jpegs()[:n])


def other(writer: EpisodeWriter) -> tuple[Any, Any]:
    stream = writer.add_stream("s", kind="acme:x", clock=CLOCK, **OTHER)
    return stream, lambda n: np.ones((n, 2), np.int32)


STREAMS = {"pose": pose, "rgb": rgb, "taxels": taxels, "files": files, "other": other}

BAD_DATA: list[tuple[str, Any]] = [
    ("pose", np.ones((1, 7))),
    ("pose", np.ones((3, 7))),
    ("pose", np.ones((2, 6))),
    ("pose", np.ones(2)),
    ("pose", 1.0),
    ("pose", [[1, 2], [3]]),
    ("pose", np.full((2, 7), "1")),
    ("pose", np.ones((2, 7), complex)),
    ("pose", None),
    ("rgb", pictures(2).astype(np.float32)),
    ("rgb", pictures(2)[:, :-1]),
    ("rgb", pictures(2, 1)),
    ("rgb", pictures(3)),
    ("rgb", pictures(1)[0]),
    ("taxels", np.ones((2, 2, 3), np.int64)),
    ("taxels", np.ones((2, 2, 3), np.float32)),  # int16 came before
    ("taxels", np.ones((2, 3, 2), np.int16)),
    ("files", [jpegs()[0]]),
    ("files", jpegs()[0]),
    ("files", []),
    ("files", [jpegs()[0], b""]),
    ("files", [jpegs()[0], b"\xff\xd8"]),
    ("files", [jpegs()[0], jpegs()[1][:40]]),
    ("files", [jpegs()[0], b"\x89PNG" + bytes(100)]),
    ("files", [jpegs()[0], jpegs(5, 1)[0]]),
    ("files", [jpegs()[0], jpeg.encode(pictures(1, height=HEIGHT + 8)[0], 90)]),
    ("other", np.ones((2, 2))),  # int32 came before
    ("other", np.ones((2, 3), np.int32)),
    ("other", np.array([["a", "b"]] * 2)),
]


@pytest.mark.parametrize(("kind", "data"), BAD_DATA)
def test_data_of_the_wrong_kind(writer: EpisodeWriter, kind: str, data: Any) -> None:
    stream, make = STREAMS[kind](writer)
    stream.append([0, 10], make(2), time_host=[1, 2])
    with pytest.raises(UsageError):
        stream.append([20, 30], data, time_host=[3, 4])
    stream.append([25], make(1), time_host=[5])
    view = finished(writer)
    assert view.time.tolist() == [0, 10, 25]
    assert view.time_host is not None
    assert view.time_host.tolist() == [1, 2, 5]
    if kind == "files":
        assert [view.encoded(i) for i in range(3)] == [jpegs()[0], jpegs()[1], jpegs()[0]]
    else:
        np.testing.assert_array_equal(view.data, [*make(2), *make(1)])


BAD_EXTRAS: list[dict[str, Any]] = [
    {},
    {"time_host": [3, 4]},
    {"sequence": [3, 4]},
    {"time_host": [3, 4], "sequence": [3, 4], "flags": [0, 0]},
    {"time_host": [3, 4], "sequence": [3, 4], "raw": [0, 0]},
    {"time_host": [3], "sequence": [3, 4]},
    {"time_host": 3, "sequence": [3, 4]},
    {"time_host": [[3, 4]], "sequence": [3, 4]},
    {"time_host": [3.5, 4.5], "sequence": [3, 4]},
    {"time_host": ["a", "b"], "sequence": [3, 4]},
    {"time_host": [3, 4], "sequence": [3, -4]},
    {"time_host": [3, 4], "sequence": [3, 2**64]},
    {"time_host": [3, 2**63], "sequence": [3, 4]},
]


@pytest.mark.parametrize("extra", BAD_EXTRAS, ids=str)
@pytest.mark.parametrize("kind", ["width", "files"])
def test_optional_arrays_that_do_not_fit(
    writer: EpisodeWriter, kind: str, extra: dict[str, Any]
) -> None:
    if kind == "files" and "raw" in extra:
        extra = {"flags": [0, 0]}  # frames have no raw values
    stream, make = (width(writer), np.ones) if kind == "width" else files(writer)
    stream.append([0, 10], make(2), time_host=[1, 2], sequence=[1, 2])
    with pytest.raises(UsageError):
        stream.append([20, 30], make(2), **extra)
    stream.append([20, 30], make(2), time_host=[3, 4], sequence=np.array([3, 2**64 - 1], np.uint64))
    view = finished(writer)
    assert view.time.tolist() == [0, 10, 20, 30]
    assert view.time_host is not None
    assert view.time_host.tolist() == [1, 2, 3, 4]
    assert view.sequence is not None
    assert view.sequence.tolist() == [1, 2, 3, 2**64 - 1]


@pytest.mark.parametrize(
    "raw",
    [None, [3.5, 4.5], np.ones((2, 2), np.uint16), ["a", "b"], [1], np.array([1, 2], np.int64)],
    ids=str,
)
def test_raw_values_that_do_not_fit(writer: EpisodeWriter, raw: Any) -> None:
    stream = width(writer)
    stream.append([0, 10], [0, 0], raw=np.array([1, 2], np.uint16))
    with pytest.raises(UsageError):
        stream.append([20, 30], [0, 0], raw=raw)
    stream.append(20, 0, raw=np.uint8(3))
    view = finished(writer)
    assert view.raw is not None
    assert view.raw.dtype == np.uint16
    assert view.raw.tolist() == [1, 2, 3]
    assert len(view.time) == len(view.data) == 3


# ------------------------------------------------------------------------------------ once a stream


def test_a_reference_is_an_image_of_the_frames_size(writer: EpisodeWriter) -> None:
    stream = writer.add_stream("s", kind="tactile", clock=CLOCK, images=encoded_images())
    image = pictures()[0]
    bad = [image[:-1], image.astype(np.float32), image[..., 0], image[None], image[..., :2]]
    for wrong in bad:
        with pytest.raises(UsageError, match="the reference is"):
            stream.set_reference(wrong, method="captured")
    stream.set_reference(image[..., :1], method="estimated", frames=[1], contact_free=False)
    with pytest.raises(UsageError, match="there is a reference array already"):
        stream.set_reference(image, method="captured")
    view = finished(writer)
    np.testing.assert_array_equal(view.reference, image[..., :1])
    assert view.metadata.reference.frames == [1]  # type: ignore[attr-defined]  # a tactile stream


def test_a_mask_has_the_shape_of_the_grid(writer: EpisodeWriter) -> None:
    stream, _ = taxels(writer)
    for wrong in (np.ones((3, 2), bool), np.ones((2, 3)), np.ones(2, bool)):
        with pytest.raises(UsageError, match="the mask is"):
            stream.set_valid(wrong)
    mask = np.array([[True, False, True]] * 2)
    stream.set_valid(mask)
    with pytest.raises(UsageError, match="already"):
        stream.set_valid(mask)
    np.testing.assert_array_equal(finished(writer).valid, mask)


def test_only_some_kinds_have_them(writer: EpisodeWriter) -> None:
    stream = width(writer)
    with pytest.raises(UsageError, match="only tactile streams"):
        stream.set_reference(pictures()[0], method="captured")
    with pytest.raises(UsageError, match="only taxel streams"):
        stream.set_valid(np.ones((2, 3), bool))


# -------------------------------------------------------------------------------------------- video


def video(writer: EpisodeWriter, clock: Clock = CLOCK) -> Any:
    size: Any = {"height": HEIGHT, "width": WIDTH, "channels": 3}
    images = VideoImages(encoding="video", **size)
    return writer.add_stream("s", kind="rgb", clock=clock, images=images)


def test_video_files_follow_each_other(writer: EpisodeWriter, tmp_path: Path) -> None:
    content, pts, keyframes, base = clip()
    stream = video(writer)
    (tmp_path / "second.mp4").write_bytes(content)
    for number, source in enumerate((content, tmp_path / "second.mp4")):
        file = video_file(content, base, f"{number}.mp4")
        file.start_ns = number * 10**9
        stream.append_file(source, file, pts=np.array(pts), keyframe=np.array(keyframes))
    view = finished(writer)
    assert view.container(0) == view.container(1) == content
    assert view.array("file").tolist() == [0] * 5 + [1] * 5
    assert view.array("keyframe").tolist() == [*keyframes, *(5 + k for k in keyframes)]
    frames = view.frames
    np.testing.assert_array_equal(frames[:5], frames[5:])
    for index in (7, 2, 9, 0, 3, 4):  # in any order
        np.testing.assert_array_equal(frames[index], frames[index % 5])
    grey = frames.read([4], grey=True)
    assert grey.shape == (1, HEIGHT, WIDTH, 1)
    with pytest.raises(IndexError):
        view.container(2)
    with pytest.raises(IndexError):
        view.container(-1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pts": [0, 1]}, "2 pts, 5 keyframes"),
        ({"pts": [0, 1, 1, 2, 3]}, "time does not increase at sample 2"),
        ({"pts": [0.5, 1, 2, 3, 4]}, "pts must be whole numbers"),
        ({"keyframe": [0, 2, 0, 0, 0]}, "a keyframe is not at or before"),
        ({"keyframe": [0, -1, 0, 0, 0]}, "a keyframe is not at or before"),
        ({"bytes": 7}, "its metadata says 7"),
    ],
)
def test_a_video_file_that_does_not_fit(
    writer: EpisodeWriter, change: dict[str, Any], message: str
) -> None:
    content, pts, keyframes, base = clip()
    stream = video(writer)
    file = video_file(content, base)
    arrays: dict[str, Any] = {"pts": pts, "keyframe": keyframes, **change}
    file.bytes = arrays.pop("bytes", file.bytes)
    with pytest.raises(UsageError, match=message):
        stream.append_file(content, file, **arrays)
    stream.append_file(content, video_file(content, base), pts=pts, keyframe=keyframes)
    assert len(finished(writer).frames[:]) == 5


def test_a_clock_corrects_the_times_of_pts(writer: EpisodeWriter) -> None:
    content, pts, keyframes, base = clip()
    clock = CLOCK.model_copy(
        update={"t_ref_ns": 50, "offset_ns": 10**9, "drift_ppm": 43.0, "latency_ns": 7}
    )
    stream = video(writer, clock)
    file = video_file(content, base)
    file.start_ns = 50
    stream.append_file(content, file, pts=pts, keyframe=keyframes)
    periods = np.arange(len(pts)) * 100_000_000  # ten frames a second
    expected = periods + periods // 1_000_000 * 43 + 10**9 - 7
    assert finished(writer).array("time").tolist() == expected.tolist()


def test_half_nanoseconds_of_pts_are_rounded_up(writer: EpisodeWriter) -> None:
    content, _, keyframes, _ = clip()
    stream = video(writer)
    file = video_file(content, "1/2000000000")
    stream.append_file(content, file, pts=[-3, -1, 1, 3, 5], keyframe=keyframes)
    assert finished(writer).array("time").tolist() == [-1, 0, 1, 2, 3]


def test_a_video_with_stamps_of_its_own(writer: EpisodeWriter) -> None:
    content, pts, keyframes, base = clip()
    clock = CLOCK.model_copy(update={"raw_time": "time_host", "latency_ns": 5})
    stream = video(writer, clock)
    host = np.array([5, 11, 18, 20, 40])
    arrays: dict[str, Any] = {"pts": pts, "keyframe": keyframes}
    file = video_file(content, base)
    with pytest.raises(UsageError, match="where the clock names a raw_time"):
        stream.append_file(content, file, **arrays)
    with pytest.raises(UsageError, match="5 pts, 4 times"):
        stream.append_file(content, file, **arrays, time=host[:4])
    with pytest.raises(UsageError, match="no array raw comes"):
        stream.append_file(content, file, **arrays, time=host - 5, raw=host)
    stream.append_file(content, file, **arrays, time=host - 5, time_host=host, sequence=range(5))
    view = finished(writer)
    assert view.array("time").tolist() == [0, 6, 13, 15, 35]
    assert view.array("time_host").tolist() == host.tolist()
    assert view.array("sequence").tolist() == list(range(5))


def test_times_of_pts_are_not_given(writer: EpisodeWriter) -> None:
    content, pts, keyframes, base = clip()
    stream = video(writer)
    file, arrays = video_file(content, base), {"pts": pts, "keyframe": keyframes}
    with pytest.raises(UsageError, match="and only there"):
        stream.append_file(content, file, **arrays, time=range(5))
    stream.append_file(content, file, **arrays)


def test_a_clock_that_leads_out_of_time(writer: EpisodeWriter) -> None:
    content, pts, keyframes, base = clip()
    stream = video(writer, CLOCK.model_copy(update={"offset_ns": 2**62 + 1}))
    with pytest.raises(UsageError, match="must lie within"):
        stream.append_file(content, video_file(content, base), pts=pts, keyframe=keyframes)
    writer.abort()


def test_a_video_stream_needs_a_file(writer: EpisodeWriter) -> None:
    video(writer)
    with pytest.raises(UsageError, match="needs at least one file"):
        writer.finish()
    writer.abort()


def test_a_file_that_cannot_be_read_spoils_the_stream_but_nothing_else(
    writer: EpisodeWriter, tmp_path: Path
) -> None:
    content, pts, keyframes, base = clip()
    stream = video(writer)
    with pytest.raises(FileNotFoundError):
        stream.append_file(
            tmp_path / "missing.mp4", video_file(content, base), pts=pts, keyframe=keyframes
        )
    stream.append_file(content, video_file(content, base), pts=pts, keyframe=keyframes)
    assert finished(writer).container() == content


def test_after_a_failure_half_way_the_stream_is_never_finished(
    writer: EpisodeWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, make = files(writer)
    stream.append([0], make(1))

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    # Times and bytes are appended by then.
    monkeypatch.setattr(stream._offset, "append", fail)
    with pytest.raises(KeyboardInterrupt):
        stream.append([1], make(1))
    monkeypatch.undo()
    for spoilt in (lambda: stream.append([2], make(1)), writer.finish):
        with pytest.raises(UsageError, match="failed half-way"):
            spoilt()
    writer.abort()
    assert not writer.path.exists()


def test_errors_name_the_stream(writer: EpisodeWriter) -> None:
    stream = width(writer)
    with pytest.raises(ExumiError) as caught:
        stream.append(0, "x")
    assert caught.value.where == "s"
