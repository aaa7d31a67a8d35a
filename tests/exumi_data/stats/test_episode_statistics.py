"""Numbers of one episode, against numbers worked out by hand."""

import json
from collections.abc import Callable
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path

import pytest

from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError, LimitError, UsageError
from exumi_data.model import Clock, Gap
from exumi_data.stats import Statistics, measure
from exumi_data.store.files import write_atomic

WriteEpisode = Callable[..., Path]
STATED = Clock(source="none", stamp_point="nominal_rate")


def measured(path: Path, **options: object) -> Statistics:
    with open_episode(path) as episode:
        return measure(episode, **options)  # type: ignore[arg-type]  # passed through


def test_rate_jitter_and_gaps(write_episode: WriteEpisode) -> None:
    # Periods in ms: 10 10 10 12 8 10 60 10. Median 10, deviations 0 0 0 2 2 0 50 0: median 0.
    steady = [0, 10, 20, 30, 42, 50, 60, 120, 130]
    # Periods 9 11 9 11: median 10, every deviation 1, so the jitter is 1.4826 ms.
    shaky = [0, 9, 20, 29, 40]
    path = write_episode(
        {
            "width": (
                steady,
                {"kind": "width", "gaps": [Gap(after=6, lost=5)], "lost": {"queue": 5}},
            ),
            "pose": (shaky, {"kind": "pose", "nominal_rate": "100"}),
        }
    )
    statistics = measured(path)
    pose, width = statistics.streams
    assert (width.name, width.n, width.duration_s) == ("width", 9, 0.13)
    assert width.rate_hz is not None
    assert width.rate_hz.median == pytest.approx(100)
    assert width.jitter_s is not None
    assert width.jitter_s.median == 0
    assert (width.gaps, width.longest_gap_s, width.episodes_with_gaps) == (1, 0.06, 1)
    assert (width.declared_gaps, width.lost) == (1, {"queue": 5})
    assert pose.jitter_s is not None
    assert pose.jitter_s.max == pytest.approx(1.4826e-3)
    assert (pose.gaps, pose.nominal_hz, pose.measured_times) == (0, {"100": 1}, True)
    assert statistics.duration_s == pytest.approx(0.13)


def test_times_that_nobody_measured_are_said_to_be_stated(write_episode: WriteEpisode) -> None:
    spec = {"kind": "tactile", "clock": STATED, "nominal_rate": "10"}
    (stream,) = measured(write_episode({"tactile": ([0, 100, 200], spec)})).streams
    assert not stream.measured_times
    assert stream.encodings == ["array"]


def test_one_tactile_stream_is_active_by_its_own_frames(write_episode: WriteEpisode) -> None:
    spec = {"kind": "tactile", "activity": [0.0, 0.1, 0.2, 0.3], "above": 0.1}
    statistics = measured(write_episode({"tactile": ([0, 30, 60, 90], spec)}))
    active = statistics.active
    assert (active.frames, active.active, active.ratio) == (4, 2, 0.5)  # 0.1 is not above 0.1
    assert (active.episodes, active.unmeasured) == (1, 0)
    (stream,) = statistics.streams
    assert (stream.active, stream.measured_activity, stream.active_above) == (2, 4, [0.1])


def test_a_moment_is_active_if_any_tactile_stream_is(write_episode: WriteEpisode) -> None:
    # The densest stream gives the moments 0 20 40 60 80 100; of the other, the nearest frames are
    # those at 5 5 45 45 85 85 (of two equally near, the earlier), and that at 45 is active.
    dense = {"kind": "tactile", "activity": [0, 0, 0, 0, 0, 1.0]}
    sparse = {"kind": "tactile", "activity": [0, 1.0, 0]}
    path = write_episode(
        {"left": ([0, 20, 40, 60, 80, 100], dense), "right": ([5, 45, 85], sparse)}
    )
    active = measured(path).active
    assert (active.frames, active.active) == (6, 3)


def test_a_frame_too_far_away_makes_no_moment_active(write_episode: WriteEpisode) -> None:
    # The other finger's only frames end at 10 ms. The tolerance is one tick, 50.05 ms.
    dense = {"kind": "tactile", "activity": [0.0] * 6}
    other = {"kind": "tactile", "activity": [1.0, 1.0]}
    path = write_episode({"left": ([0, 20, 40, 60, 80, 100], dense), "right": ([0, 10], other)})
    assert measured(path).active.active == 4  # 0, 20, 40 and 60 ms: 60 - 10 is within the tick


def test_activity_that_is_missing_is_not_taken_for_rest(write_episode: WriteEpisode) -> None:
    known = {"kind": "tactile", "activity": [1.0, 1.0]}
    path = write_episode({"left": ([0, 20], known), "right": ([0, 20], {"kind": "tactile"})})
    active = measured(path).active
    assert (active.episodes, active.unmeasured, active.frames) == (0, 1, 0)
    assert active.ratio is None


def test_usable_ticks_of_images_and_of_numbers(write_episode: WriteEpisode) -> None:
    # Ticks of 100 ms from 0 to 1000: 11. Camera: frames every 100 ms to 500, tolerance 100 ms (one
    # tick), so valid to 600: 7 ticks. Width: every 50 ms, none between 300 and 700; that gap is
    # longer than max(100 ms, 2.5 * 50 ms), so 400, 500 and 600 are invalid: 8 ticks.
    # Both: 0 100 200 300: 4.
    path = write_episode(
        {
            "rgb": (list(range(0, 501, 100)), {"kind": "rgb"}),
            "width": (
                [*range(0, 301, 50), *range(700, 1001, 50)],
                {"kind": "width"},
            ),
        }
    )
    statistics = measured(path, tick_s=Fraction(1, 10))
    usable = statistics.usable
    assert (usable.ticks, usable.usable) == (11, 4)
    assert usable.ratio == pytest.approx(4 / 11)
    assert {s.name: s.usable for s in statistics.streams} == {
        "rgb": pytest.approx(7 / 11),
        "width": pytest.approx(8 / 11),
    }
    only_width = measured(path, tick_s=0.1, required=["width"]).usable
    assert (only_width.ticks, only_width.usable) == (11, 8)
    assert only_width.required == ["width"]


def test_slow_cameras_are_valid_within_most_of_a_period(write_episode: WriteEpisode) -> None:
    # 2 fps: 0.6 periods are 300 ms, so every tick of 100 ms has a frame in reach.
    path = write_episode({"rgb": ([0, 500, 1000], {"kind": "rgb"})})
    assert measured(path, tick_s=0.1).usable.ratio == 1


def test_a_stream_without_samples_makes_nothing_usable(write_episode: WriteEpisode) -> None:
    path = write_episode(
        {"rgb": ([0, 100, 200], {"kind": "rgb"}), "width": ([], {"kind": "width"})}
    )
    statistics = measured(path, tick_s=0.1)
    assert (statistics.usable.ticks, statistics.usable.usable) == (3, 0)
    assert [stream.empty for stream in statistics.streams] == [0, 1]
    assert statistics.streams[1].rate_hz is None
    assert measured(path, tick_s=0.1, required=["rgb"]).usable.ratio == 1


def test_sizes_add_up_to_the_folder(write_episode: WriteEpisode) -> None:
    path = write_episode({"tactile": ([0, 50], {"kind": "tactile", "activity": [0, 0]})})
    statistics = measured(path)
    files = [file for file in path.rglob("*") if file.is_file()]
    sizes = statistics.sizes
    assert sizes.bytes == sum(file.stat().st_size for file in files)
    assert sizes.bytes == sizes.streams + sizes.derived + sizes.metadata
    (stream,) = statistics.streams
    inside = [file for file in files if path / "streams" / "tactile" in file.parents]
    assert stream.bytes == sum(file.stat().st_size for file in inside)
    assert stream.bytes_per_sample == stream.bytes / 2
    assert sizes.derived > 0


def test_everything_can_be_written_as_json(write_episode: WriteEpisode) -> None:
    few: list[dict[str, object]] = [
        {},
        {"width": ([], {"kind": "width"})},
        {"width": ([7], {"kind": "width"})},
    ]
    for streams in few:
        statistics = measured(write_episode(streams))
        document = json.loads(json.dumps(asdict(statistics), allow_nan=False))
        assert document["what"] == "episode"
        assert document["demonstrations_per_hour"] is None


def test_unknown_required_streams_and_bad_ticks_are_refused(write_episode: WriteEpisode) -> None:
    path = write_episode({"width": ([0, 10], {"kind": "width"})})
    with pytest.raises(UsageError, match=r"no episode has a stream 'pose'.*width"):
        measured(path, required=["pose"])
    with pytest.raises(UsageError, match="not positive"):
        measured(path, tick_s=0)


def test_an_episode_that_claims_to_last_for_ever(write_episode: WriteEpisode) -> None:
    path = write_episode({"width": ([0, 10**12], {"kind": "width"})})
    with pytest.raises(LimitError, match="too long"):
        measured(path)


def test_a_missing_array_is_an_error(write_episode: WriteEpisode) -> None:
    path = write_episode({"width": ([0, 10], {"kind": "width"})})
    shard = next((path / "streams" / "width" / "time").rglob("c/*"))
    write_atomic(shard, shard.read_bytes()[:-9])
    with pytest.raises(DamagedDataError):
        measured(path)
