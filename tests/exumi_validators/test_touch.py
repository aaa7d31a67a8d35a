"""Rules of touch: found beyond each limit, and not before it."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import ArrayImages, DatasetMetadata, EncodedImages, Sensor, VideoImages
from exumi_data.simulation import simulate_play
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import ACTIVE_THRESHOLD, ActivityMeter, to_grey
from exumi_data.tactile.wrapping import Jumps
from exumi_validators import Report, validate
from exumi_validators.checks.dataset import same_gel
from exumi_validators.dataset_context import DatasetContext
from exumi_validators.episode_run import EpisodeFacts, ReferenceFacts
from exumi_validators.frame_statistics import FrameStatistics, GlanceLimits
from exumi_validators.report import Problem, Skipped
from exumi_validators.touch_measures import coarse, nearest_to, shift_between, texture
from exumi_validators.touch_pass import spread
from tests.exumi_data.builders import (
    CLOCK,
    clip_of,
    edit_metadata,
    episode_id,
    metadata,
    pictures,
    video_file,
)

SIDE = 48
FRAMES = 40
LIMITS = GlanceLimits(
    dark_level=10,
    saturated_level=250,
    saturated_share=0.1,
    pixels=600,
    thumbnail_pixels=4800,
    jump_rows=16,
    jump_apart_px=2,
)


def gel(seed: int = 0, side: int = SIDE) -> np.ndarray:
    """A smooth pattern, (side, side, 1) uint8 around 100."""
    coarse_pattern = np.random.default_rng(seed).integers(70, 130, (side // 4, side // 4))
    return np.kron(coarse_pattern, np.ones((4, 4))).astype(np.uint8)[..., None]


def recorded(base: np.ndarray, count: int = FRAMES) -> np.ndarray:
    """Frames of a gel that is pressed in every other frame, with noise."""
    noise = np.random.default_rng(9).integers(0, 3, (count, *base.shape)).astype(np.uint8)
    frames: np.ndarray = base + noise
    frames[1::2, 8:24, 8:24] += 60
    return frames


def write(
    path: Path,
    frames: np.ndarray,
    reference: np.ndarray | None,
    *,
    encoding: str = "array",
    activity: np.ndarray | None = None,
    flags: np.ndarray | None = None,
    regime: str = "touch",
    number: int = 0,
    step_ns: int = 40_000_000,
    **fields: Any,
) -> Report:
    """Write an episode of one tactile stream and validate it."""
    size: Any = dict(zip(("height", "width", "channels"), frames.shape[1:], strict=True))
    images: Any = ArrayImages(encoding="array", **size)
    samples: Any = frames
    if encoding == "encoded":
        images = EncodedImages(encoding="encoded", media_type="image/jpeg", **size)
        samples = [jpeg.encode(frame, 95) for frame in frames]
    time = np.arange(len(frames), dtype=np.int64) * step_ns
    with EpisodeWriter(path, metadata(number, regime=regime), durable=False) as writer:
        stream = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=images, **fields)
        stream.append(time, samples, **({} if flags is None else {"flags": flags}))
        if reference is not None:
            stream.set_reference(reference, method="captured", contact_free=True)
        if activity is not None:
            writer.add_derived(
                "tactile",
                "activity",
                activity.astype(np.float32),
                algorithm="exumi-activity/1",
                parameters={"threshold": 5.8, "size": 224, "active_above": 1e-3},
            )
    report: Report = validate(path)
    return report


def write_video(path: Path, frames: np.ndarray, reference: np.ndarray) -> Report:
    """Write an episode of one tactile stream that is a video, and validate it."""
    content, pts, keyframes, base = clip_of(frames)
    size: Any = dict(zip(("height", "width", "channels"), frames.shape[1:], strict=True))
    images = VideoImages(encoding="video", files=[], **size)
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        video = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=images)
        video.append_file(
            content, video_file(content, base), pts=np.array(pts), keyframe=np.array(keyframes)
        )
        video.set_reference(reference, method="selected", frames=[2])
    report: Report = validate(path)
    return report


def touch_codes(report: Report) -> list[str]:
    assert report.coverage.unchecked == ()
    return sorted(p.code for p in report.problems if p.code.startswith("TACT"))


def skipped(report: Report) -> set[str]:
    return {item.code for item in report.coverage.skipped if item.code.startswith("TACT")}


# ---------------------------------------------------------------------------------------- activity


@pytest.mark.parametrize(
    ("regime", "active", "expected"),
    [
        ("play", 23, ["TACT-004"]),
        ("play", 24, []),
        ("demonstration", 0, ["TACT-005"]),
        ("demonstration", 1, []),
        ("demonstration", 24, []),
        ("demonstration", 25, ["TACT-005"]),
        ("touch", 0, []),
        ("touch", 40, []),
    ],
)
def test_activity_is_judged_by_the_regime(
    tmp_path: Path, regime: str, active: int, expected: list[str]
) -> None:
    activity = np.where(np.arange(FRAMES) < active, 0.01, 0.001)  # 0.001 is not above 0.001
    report = write(tmp_path / "e.zarr", recorded(gel()), gel(), activity=activity, regime=regime)
    assert touch_codes(report) == expected


@pytest.mark.parametrize(
    ("regime", "active", "seconds", "expected"),
    [
        ("play", 99, 19.99, []),
        ("play", 99, 20, ["TACT-013"]),
        ("play", 98, 20, []),
        ("play", 100, 300, ["TACT-013"]),
        ("touch", 100, 20, []),
        ("demonstration", 100, 20, ["TACT-005"]),
    ],
)
def test_play_lets_go_now_and_then(
    tmp_path: Path, regime: str, active: int, seconds: float, expected: list[str]
) -> None:
    report = write(
        tmp_path / "e.zarr",
        recorded(gel(), 100),
        gel(),
        activity=np.where(np.arange(100) < active, 0.2, 0.0),
        regime=regime,
        step_ns=round(seconds * 1e9 / 99 + 0.5),
    )
    assert touch_codes(report) == expected
    assert ("TACT-013" in skipped(report)) == (regime == "play" and seconds < 20)


def test_the_references_of_swapped_fingers_leave_no_quiet_frame() -> None:
    """What the limit of 99 % rests on, by a simulated session of play."""
    session = simulate_play(seed=3, duration_s=10.0)
    left, right = (session.streams[f"tactile_{side}"] for side in ("left", "right"))
    assert left.reference is not None
    assert right.reference is not None
    frames = [to_grey(left.render(i)) for i in range(0, len(left.capture_time_ns), 10)]
    shares = []
    for reference, mirrored in ((left.reference, 1), (right.reference, 1), (left.reference, -1)):
        meter = ActivityMeter(reference)
        measured = [meter.measure(np.ascontiguousarray(grey[:, ::mirrored])) for grey in frames]
        shares.append(np.mean(np.array(measured) > ACTIVE_THRESHOLD))
    assert shares[0] < 0.9
    assert shares[1:] == [1.0, 1.0]


@pytest.mark.parametrize("count", [29, 30])
def test_few_frames_have_no_ratio(tmp_path: Path, count: int) -> None:
    report = write(
        tmp_path / "e.zarr",
        recorded(gel(), count),
        gel(),
        activity=np.zeros(count),
        regime="demonstration",
    )
    assert ("TACT-005" in skipped(report)) == (count == 29)
    assert touch_codes(report) == (["TACT-005"] if count == 30 else [])


def test_activity_that_is_not_stored_is_not_judged(tmp_path: Path) -> None:
    report = write(tmp_path / "e.zarr", recorded(gel()), gel(), regime="play")
    assert touch_codes(report) == []
    assert "TACT-004" in skipped(report)


# ------------------------------------------------------------------------------------------ frames


@pytest.mark.parametrize("encoding", ["array", "encoded"])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_sound_stream_is_silent(tmp_path: Path, encoding: str, channels: int) -> None:
    base = gel().repeat(channels, axis=2)
    report = write(tmp_path / "e.zarr", recorded(base), base, encoding=encoding)
    assert touch_codes(report) == []
    assert skipped(report) == {"TACT-010", "TACT-014"}  # one finger; no colours


def red_from_the_left(levels: float = 40.0) -> np.ndarray:
    """A gel in red light from the left, (SIDE, SIDE, 3) uint8."""
    ramp = np.linspace(levels, 0, SIDE)[:, None] * np.array([1.0, 0.7, 0.4])
    return np.tile((80 + ramp).astype(np.uint8), (SIDE, 1, 1))


@pytest.mark.parametrize("encoding", ["array", "encoded", "video"])
@pytest.mark.parametrize(
    ("turn", "told"),
    [
        (np.s_[:, :], []),
        (np.s_[::-1, :], []),
        (np.s_[:, ::-1], ["mirrored"]),
        (np.s_[:, :, ::-1], ["with its channels reversed"]),
        (np.s_[:, ::-1, ::-1], ["mirrored"]),  # what else is wrong shows once that is mended
    ],
)
def test_a_reference_with_other_sides_or_colours_is_found(
    tmp_path: Path, encoding: str, turn: Any, told: list[str]
) -> None:
    base = red_from_the_left()
    path, reference = tmp_path / "e.zarr", np.ascontiguousarray(base[turn])
    if encoding == "video":
        report = write_video(path, recorded(base), reference)
    else:
        report = write(path, recorded(base), reference, encoding=encoding)
    found = [p for p in report.problems if p.code == "TACT-014"]
    assert {p.location.path for p in found} <= {"streams/tactile/reference"}
    assert [p.message.split(",")[0] for p in found] == told
    assert "TACT-014" not in skipped(report)


@pytest.mark.parametrize(("share", "expected"), [(0.30, 1), (0.36, 0)])
def test_frames_between_a_reference_and_its_mirror_image(
    tmp_path: Path, share: float, expected: int
) -> None:
    # With this share of the reference: share / (1 - share) is 0.43 and 0.56; the limit is 0.5.
    reference = red_from_the_left()[..., :1]
    mirrored = reference[:, ::-1]
    frames = np.repeat((share * reference + (1 - share) * mirrored)[None], FRAMES, axis=0)
    report = write(tmp_path / "e.zarr", frames.round().astype(np.uint8), reference)
    assert touch_codes(report).count("TACT-014") == expected


@pytest.mark.parametrize(("levels", "judged"), [(3.5, True), (2.5, False)])
def test_a_reference_that_looks_the_same_in_a_mirror_tells_nothing(
    tmp_path: Path, levels: float, judged: bool
) -> None:
    base = red_from_the_left(levels)[..., :1]  # differs from its mirror image by half of that
    report = write(tmp_path / "e.zarr", np.repeat(base[None], FRAMES, axis=0), base[:, ::-1])
    assert ("TACT-014" in touch_codes(report)) == judged
    reasons = {item.reason for item in report.coverage.skipped if item.code == "TACT-014"}
    assert ("mirrored, the reference looks the same" in reasons) != judged


def test_a_reference_of_another_size_is_not_compared_in_colour() -> None:
    statistics = FrameStatistics(
        (SIDE, SIDE), LIMITS, kept=[], searched=[0], coloured=red_from_the_left()[:-1]
    )
    statistics.search(0, red_from_the_left())
    assert statistics.colours_of_reference is None
    assert statistics.colours is None


def test_a_reference_of_less_light_is_found(tmp_path: Path) -> None:
    assert touch_codes(write(tmp_path / "a.zarr", recorded(gel()), gel() - np.uint8(10))) == [
        "TACT-006"
    ]
    # noise is 0 to 2 levels, 1 in the median
    assert touch_codes(write(tmp_path / "b.zarr", recorded(gel()), gel() - np.uint8(6))) == []


def test_without_a_reference_nothing_is_compared_with_it(tmp_path: Path) -> None:
    report = write(tmp_path / "e.zarr", recorded(gel()), None)
    assert touch_codes(report) == ["TACT-002"]
    assert {"TACT-006", "TACT-009"} <= skipped(report)


@pytest.mark.parametrize(("columns", "expected"), [(8, ["TACT-007"]), (3, [])])
def test_white_frames_are_found(tmp_path: Path, columns: int, expected: list[str]) -> None:
    frames = recorded(gel())
    frames[16:20, :, :columns] = 255
    report = write(tmp_path / "e.zarr", frames, gel())
    assert touch_codes(report) == expected
    assert [p.location.index for p in report.problems if p.code == "TACT-007"] == [16] * len(
        expected
    )


@pytest.mark.parametrize(("share", "expected"), [(0.3, ["TACT-008"]), (0.6, [])])
def test_dark_frames_are_found_against_the_reference(
    tmp_path: Path, share: float, expected: list[str]
) -> None:
    frames = recorded(gel())
    frames[24] = (frames[24] * share).astype(np.uint8)
    report = write(tmp_path / "e.zarr", frames, gel())
    assert touch_codes(report) == expected


def test_black_frames_are_found_without_a_reference_unless_they_are_flagged(
    tmp_path: Path,
) -> None:
    frames = recorded(gel())
    frames[24] = 0
    flags = np.zeros(FRAMES, np.uint32)
    assert "TACT-008" in touch_codes(write(tmp_path / "a.zarr", frames, None, flags=flags))
    flags[24] = 8  # invalid
    assert "TACT-008" not in touch_codes(write(tmp_path / "b.zarr", frames, None, flags=flags))


@pytest.mark.parametrize(("pixels", "expected"), [(0, False), (2, False), (4, True), (6, True)])
def test_a_gel_that_moved_is_found(tmp_path: Path, pixels: int, expected: bool) -> None:
    moved = np.roll(gel(side=96), pixels, axis=1)
    found = touch_codes(write(tmp_path / "e.zarr", recorded(moved), gel(side=96)))
    assert ("TACT-009" in found) == expected


def test_a_plain_gel_shows_no_shift(tmp_path: Path) -> None:
    plain = np.full((SIDE, SIDE, 1), 100, np.uint8)
    assert "TACT-009" in skipped(write(tmp_path / "e.zarr", recorded(plain), plain))


@pytest.mark.parametrize("encoding", ["array", "encoded"])
@pytest.mark.parametrize("wraps", [True, False])
def test_differences_that_wrapped_are_found(tmp_path: Path, encoding: str, wraps: bool) -> None:
    side = 160
    y, x = np.mgrid[:side, :side] - side // 2
    depth = np.maximum(0, 60 - np.hypot(x, y)).astype(np.int64) * 7
    frames = np.full((8, side, side, 3), 120, np.uint8)
    frames[..., :2] = 0
    frames[4:, ..., 1] = depth % 256 if wraps else np.minimum(depth, 255)
    frames[:, 0, 0, 2] = np.arange(8)
    found = touch_codes(write(tmp_path / "e.zarr", frames, frames[0], encoding=encoding))
    assert ("TACT-011" in found) == wraps


def test_a_video_is_looked_at_in_full_range(tmp_path: Path) -> None:
    # five frames that all differ: none is near the reference but the one that it is
    report = write_video(tmp_path / "e.zarr", pictures(), pictures()[2])
    assert "TACT-007" not in touch_codes(report)
    assert "TACT-008" not in touch_codes(report)
    assert "TACT-006" not in skipped(report)


def test_frames_that_cannot_be_decoded_are_not_judged(tmp_path: Path) -> None:
    path = tmp_path / "e.zarr"
    write(path, recorded(gel()), gel())
    shutil.rmtree(path / "streams/tactile/data/c")
    report = validate(path)
    assert {"TACT-006", "TACT-007", "TACT-008", "TACT-011"} <= skipped(report)


# ----------------------------------------------------------------------------------------- fingers


@pytest.fixture
def fingers(tmp_path: Path) -> Path:
    """The corpus's episode whose fingers are swapped."""
    corpus = Path(__file__).parents[2] / "spec/conformance/1.0/invalid"
    return Path(shutil.copytree(corpus / "TACT-010__swapped/store.zarr", tmp_path / "e.zarr"))


def test_fingers_that_are_not_swapped_are_silent(fingers: Path) -> None:
    def exchange(document: Any) -> None:
        left, right = document["calibration"].values()
        left["array"], right["array"] = right["array"], left["array"]

    assert touch_codes(validate(fingers)) == ["TACT-010", "TACT-010"]
    edit_metadata(fingers, exchange)
    report = validate(fingers)
    assert touch_codes(report) == []
    assert "TACT-010" not in skipped(report)


def test_one_finger_alone_is_not_judged(fingers: Path) -> None:
    edit_metadata(
        fingers, lambda document: document["calibration"].pop("tactile_reference/tactile_left")
    )
    report = validate(fingers)
    assert "TACT-010" in skipped(report)
    assert touch_codes(report) == []


def test_references_that_look_alike_tell_nothing(fingers: Path) -> None:
    path = "calibration/tactile_reference/tactile_"
    edit_metadata(
        fingers,
        lambda document: document["calibration"]["tactile_reference/tactile_right"].update(
            array=f"{path}left"
        ),
    )
    assert "TACT-010" in skipped(validate(fingers))


# ----------------------------------------------------------------------------------------- dataset


def facts(path: str, level: int, *, start: str | None = None, serial: str = "7") -> EpisodeFacts:
    image = np.full((48, 64), level, np.uint8)
    reference = ReferenceFacts(
        stream="tactile", model="gelsight-mini", serial=serial, coarse=coarse(image, 16, 12)
    )
    return EpisodeFacts(id=path, start=start, references=(reference,))


def gel_findings(
    tmp_path: Path, *found: EpisodeFacts, limits: dict[str, dict[str, float]] | None = None
) -> list[tuple[str, str]]:
    dataset = DatasetContext(tmp_path, limits)
    dataset.facts = {str(item.id): item for item in found}
    return [
        (item.code, item.location.path if isinstance(item, Problem) else item.path)
        for item in same_gel(dataset)
    ]


def test_a_changed_gel_is_reported_once(tmp_path: Path) -> None:
    levels = [100, 104, 120, 121, 118]
    found = [facts(f"e{i}", level) for i, level in enumerate(levels)]
    assert gel_findings(tmp_path, *found) == [("TACT-012", "e2/streams/tactile/reference")]


def test_a_gel_is_judged_by_the_limit_that_was_asked_for(tmp_path: Path) -> None:
    found = [facts("e0", 100), facts("e1", 112)]
    limits = {"TACT-012": {"mean_grey_levels": 20.0}}
    assert gel_findings(tmp_path, *found, limits=limits) == []
    limits = {"TACT-012": {"mean_grey_levels": 11.0}}
    assert len(gel_findings(tmp_path, *found, limits=limits)) == 1


def test_a_worn_gel_is_found_though_no_step_is_large(tmp_path: Path) -> None:
    found = [facts(f"e{i}", 100 + 3 * i) for i in range(6)]
    assert gel_findings(tmp_path, *found) == [("TACT-012", "e3/streams/tactile/reference")]


def test_episodes_are_compared_in_order_of_time(tmp_path: Path) -> None:
    late = facts("a", 120, start="2026-05-02T10:00:00.000000000Z")
    early = facts("b", 100, start="2026-05-01T10:00:00.000000000Z")
    assert gel_findings(tmp_path, late, early) == [("TACT-012", "a/streams/tactile/reference")]


def test_sensors_are_not_compared_with_each_other(tmp_path: Path) -> None:
    two = facts("a", 100), facts("b", 150, serial="8")
    assert gel_findings(tmp_path, *two) == [("TACT-012", ".")]
    assert isinstance(next(iter(same_gel(_context(tmp_path, *two)))), Skipped)


def _context(root: Path, *found: EpisodeFacts) -> DatasetContext:
    dataset = DatasetContext(root)
    dataset.facts = {str(item.id): replace(item) for item in found}
    return dataset


def test_references_of_a_sensor_go_from_episodes_to_the_dataset(tmp_path: Path) -> None:
    root = tmp_path / "d"
    create_dataset(root, DatasetMetadata(name="tests", licence="CC0-1.0"))
    for number, level in enumerate((0, 20)):
        base = gel() + np.uint8(level)
        path = root / episode_path(episode_id(number))
        sensor = Sensor(model="gelsight-mini", serial="7")
        write(path, recorded(base, 4), base, number=number, sensor=sensor)
    table, failed = build_catalog(root)
    assert not failed
    write_catalog(root, table)
    assert validate(root).codes() == {"TACT-012": 1}
    assert "TACT-012" not in validate(root, levels=["arrays"]).codes()


# ---------------------------------------------------------------------------------------- measures


def looks(
    count: int, kept: list[int], searched: list[int], size: tuple[int, int] = (24, 32)
) -> Iterator[FrameStatistics]:
    """Statistics of grey frames of level 100."""
    found = FrameStatistics(size, LIMITS, kept=kept, searched=searched)
    for index in range(count):
        found.add(index, np.full((*size, 1), 100, np.uint8))
    found.end()
    yield found


def test_memory_does_not_grow_with_frames() -> None:
    (found,) = looks(5000, [0, 2500], [])
    assert found.glanced == 5000
    assert sorted(found.thumbnails) == [0, 2500]
    assert not found._frames
    assert found._pixels is not None
    assert len(found._pixels) == 64


def test_a_frame_is_kept_although_its_memory_is_used_again() -> None:
    found = FrameStatistics((24, 32), LIMITS, kept=[0, 1], searched=[])
    memory = np.empty((24, 32, 1), np.uint8)
    for index in range(2):
        memory[:] = 100 + index
        found.add(index, memory)
    assert [int(found.thumbnails[index].max()) for index in (0, 1)] == [100, 101]


@pytest.mark.parametrize("size", [(1, 1), (1, 4000), (3000, 2), (480, 640)])
def test_images_of_any_shape_are_sampled(size: tuple[int, int]) -> None:
    (found,) = looks(9, [0, 1, 2], [], size)
    assert (found.glanced, found.dark.count, found.saturated.count) == (9, 0, 0)
    for image in found.thumbnails.values():
        assert image.size <= 20_000


def test_frames_of_two_ranges_are_not_mixed() -> None:
    from exumi_data.store.video import LIMITED_TO_FULL

    found = FrameStatistics((24, 32), LIMITS, kept=[], searched=[])
    for index in range(4):
        levels = LIMITED_TO_FULL if index in (1, 2) else None
        found.add(index, np.full((24, 32), 20, np.uint8), levels=levels)
    found.end()
    assert (found.glanced, found.dark.count, found.dark.first) == (4, 2, 1)  # 20 stands for 5


@pytest.mark.parametrize("level", [0, 255])
def test_every_frame_is_judged(tmp_path: Path, level: int) -> None:
    frames = recorded(gel())
    frames[[index for index in range(FRAMES) if index % 8]] = level
    report = write(tmp_path / "e.zarr", frames, gel())
    code = "TACT-008" if level == 0 else "TACT-007"
    (problem,) = (p for p in report.problems if p.code == code)
    assert problem.location.index == 1
    assert "35 of 40 frames" in problem.message


def test_stored_levels_are_translated() -> None:
    from exumi_data.store.video import LIMITED_TO_FULL

    assert LIMITED_TO_FULL[[0, 16, 235, 255]].tolist() == [0, 0, 255, 255]
    found = FrameStatistics((24, 32), LIMITS, kept=[0], searched=[])
    found.add(0, np.full((24, 32), 20, np.uint8), levels=LIMITED_TO_FULL)
    found.end()
    assert found.dark.count == 1  # 20 stands for 5
    assert np.unique(found.thumbnails[0]).tolist() == [5]


def test_frames_are_chosen_all_over_the_stream() -> None:
    assert spread(4, 12) == [0, 1, 2, 3]
    assert spread(120, 12) == list(range(5, 120, 10))
    cost = np.ones(120)
    cost[[3, 47]] = 0
    chosen = spread(120, 12, cost)
    assert (chosen[0], chosen[4], len(chosen)) == (3, 47, 12)
    cost[:20] = np.nan
    assert spread(120, 12, cost)[0] == 20


@pytest.mark.parametrize(("right", "down"), [(2.0, 0.0), (0.0, -3.0), (1.5, 2.5)])
def test_a_shift_is_measured(right: float, down: float) -> None:
    import cv2

    base = cv2.GaussianBlur(gel(side=96)[..., 0], (5, 5), 0)
    move = np.array([[1, 0, right], [0, 1, down]], np.float32)
    moved = cv2.warpAffine(base, move, (96, 96), borderMode=cv2.BORDER_REFLECT)
    found = shift_between(np.asarray(base, np.uint8), np.asarray(moved, np.uint8))
    assert (found.right, found.down) == pytest.approx((right, down), abs=0.3)
    assert found.left_over < 0.5


def test_noise_is_no_shift() -> None:
    base = gel(side=96)[..., 0]
    noisy = base + np.random.default_rng(0).integers(0, 6, base.shape).astype(np.uint8)
    found = shift_between(base, noisy)
    assert found.length < 0.5
    assert texture(np.full((40, 40), 7, np.uint8)) == 0


def test_the_nearest_images_come_first() -> None:
    images = [np.full((4, 4), level, np.uint8) for level in (90, 120, 130, 60, 100, 111)]
    near = nearest_to(np.full((4, 4), 104, np.uint8), images)
    assert [int(image[0, 0]) for image in near] == [100, 111]


def test_jumps_are_counted_by_channel() -> None:
    frame = np.zeros((16, 20, 3), np.uint8)
    frame[:, 10:, 1] = 250  # two pairs a row reach over the edge
    frame[:, 10:, 2] = 100
    found = Jumps(rows=16, apart_px=2)
    found.add(frame)
    assert (found.pairs, found.jumps.tolist(), found.steps.tolist()) == (
        288,
        [0, 32, 0],
        [0, 0, 32],
    )
    assert found.rates() == (32 * 1e4 / 288, 32.0)
