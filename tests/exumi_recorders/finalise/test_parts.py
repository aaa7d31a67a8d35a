"""Parts of finalising: losses, clocks, poses and widths, block by block."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.geometry import pose_to_matrix
from exumi_data.model import Clock
from exumi_data.standard import flags
from exumi_data.width_map import WidthMap, read_width_map
from exumi_recorders.finalise.clocks import StreamTimes, epoch_of, utc_text
from exumi_recorders.finalise.losses import FLAG, MOST_GAPS, Losses
from exumi_recorders.finalise.poses import IDENTITY, PoseSigns, to_world
from exumi_recorders.journal.header import JournalHeader
from exumi_recorders.journal.journal import CLOCK_PAIR
from exumi_recorders.journal.reading import Block
from exumi_recorders.journal.record import NONE, RESTARTED
from tests.exumi_recorders.numbered import episode

S = 1_000_000_000


def take(
    losses: Losses,
    sequence: list[int | None],
    *,
    seq: list[int] | None = None,
    restarted: tuple[int, ...] = (),
    damaged: tuple[int, ...] = (),
    left_out: dict[int, int] | None = None,
) -> tuple[list[int] | None, list[str]]:
    """Return numbers and the names of flags, of samples with these of the device."""
    count = len(sequence)
    numbers = np.array([NONE if each is None else each for each in sequence], np.int64)
    if seq is None:
        seq = list(range(losses.count, losses.count + count))
    found = losses.take(
        np.array(seq, np.uint64),
        numbers,
        np.array([RESTARTED if i in restarted else 0 for i in range(count)], np.uint32),
        damaged=np.array([i in damaged for i in range(count)], np.bool_),
        left_out=np.array([(left_out or {}).get(i, 0) for i in range(count)], np.int64),
    )
    names = {0: "", FLAG["gap_before"]: "gap", FLAG["out_of_order"]: "late"}
    said = [names.get(int(flag), "both") for flag in found.flags]
    return None if found.sequence is None else found.sequence.tolist(), said


def gaps(losses: Losses) -> list[tuple[int, int | None]]:
    return [(gap.after, gap.lost) for gap in losses.gaps() or []]


def test_flags_are_those_of_the_registry() -> None:
    assert {name: flag.mask for name, flag in flags().items()} == FLAG


def test_numbers_wrap_and_holes_are_gaps() -> None:
    losses = Losses(16)
    assert take(losses, [14, 15, 0, 1])[0] == [14, 15, 16, 17]
    assert take(losses, [2, 5, 6])[0] == [18, 21, 22]
    assert take(losses, [13])[0] == [29]
    assert gaps(losses) == [(4, 2), (6, 6)]
    assert losses.lost == {"sequence": 8}


def test_a_step_of_more_than_half_the_modulus_goes_back() -> None:
    losses = Losses(16)
    assert take(losses, [14, 15, 0, 15, 1])[0] == [14, 15, 16, 15, 17]
    assert gaps(losses) == []


def test_a_late_number_fills_its_gap() -> None:
    losses = Losses(None)
    assert take(losses, [0, 1, 3]) == ([0, 1, 3], ["", "", "gap"])
    assert gaps(losses) == [(1, 1)]
    assert take(losses, [2, 4]) == ([2, 4], ["late", ""])
    assert gaps(losses) == []
    assert losses.lost == {"sequence": 0}


def test_a_number_twice_is_out_of_order() -> None:
    losses = Losses(None)
    assert take(losses, [7, 7, 8]) == ([7, 7, 8], ["", "late", ""])
    assert gaps(losses) == []


def test_holes_of_the_journal_are_what_was_dropped() -> None:
    losses = Losses(None)
    take(losses, [0, 1, 4, 5], seq=[0, 1, 4, 5])
    assert gaps(losses) == [(1, 2)]
    assert losses.lost == {"queue": 2}
    take(losses, [9], seq=[8])  # two were dropped here, and one was lost before
    assert gaps(losses) == [(1, 2), (3, 3)]
    assert losses.lost == {"queue": 4, "sequence": 1}


def test_what_was_dropped_before_the_first_sample_is_counted() -> None:
    losses = Losses(None)
    take(losses, [None, None], seq=[3, 4])
    assert gaps(losses) == [(-1, 3)]


def test_damage_is_told_from_drops() -> None:
    losses = Losses(None)
    take(losses, [0, 5], seq=[0, 5], damaged=(1,))
    assert losses.lost == {"journal": 4}
    take(losses, [6], seq=[6], damaged=(0,))  # nothing is missing by the numbers: it is not known
    assert gaps(losses) == [(0, 4), (1, None)]


def test_a_device_that_was_gone_counts_anew() -> None:
    losses = Losses(None)
    take(losses, [500, 501])
    assert take(losses, [0, 1], restarted=(0,)) == ([502, 503], ["gap", ""])
    assert gaps(losses) == [(1, None)]
    take(losses, [9000])
    assert take(losses, [3])[1] == ["gap"]  # and one that begins anew by itself


def test_a_number_that_wraps_and_is_far_behind_is_that_of_a_device_that_counts_anew() -> None:
    losses = Losses(1 << 32)
    take(losses, [(1 << 32) - 1, 0, 1, 50_000])
    found, said = take(losses, [0, 1, 2])
    assert said == ["gap", "", ""]
    assert found == [(1 << 32) + 50_001, (1 << 32) + 50_002, (1 << 32) + 50_003]


def test_files_that_are_left_out_are_gaps() -> None:
    losses = Losses(None)
    take(losses, [0, 2, 3], seq=[0, 2, 3], left_out={1: 1})
    losses.left_out_at_the_end(2)
    assert gaps(losses) == [(0, 1), (2, 2)]
    assert losses.lost == {"unreadable": 3}


def test_gaps_beyond_what_a_document_holds_are_counted() -> None:
    losses = Losses(None)
    numbers = list(range(0, 2 * (MOST_GAPS + 10), 2))
    said = take(losses, list(numbers))[1]
    assert len(losses.gaps() or []) == MOST_GAPS
    assert losses.unlisted == 9
    assert said.count("gap") == MOST_GAPS + 9
    assert losses.lost == {"sequence": MOST_GAPS + 9}


@given(st.data())
def test_blocks_do_not_matter(data: st.DataObject) -> None:
    modulus = data.draw(st.sampled_from([None, 64]))
    steps = data.draw(st.lists(st.sampled_from([1, 1, 1, 2, 5, 0, -1, 9]), min_size=1, max_size=40))
    values = np.cumsum([20, *steps])
    raw = [int(each) if modulus is None else int(each % modulus) for each in values]
    whole, parts = Losses(modulus), Losses(modulus)
    expected = take(whole, list(raw))
    cut = data.draw(st.integers(0, len(raw)))
    first = take(parts, list(raw[:cut])) if cut else ([], [])
    second = take(parts, list(raw[cut:])) if cut < len(raw) else ([], [])
    assert [a + b for a, b in zip(first, second, strict=True)] == list(expected)  # type: ignore[operator]
    assert gaps(whole) == gaps(parts)
    assert {k: v for k, v in whole.lost.items() if v} == {k: v for k, v in parts.lost.items() if v}


# ------------------------------------------------------------------------------------------ clocks


def pairs(*given_pairs: tuple[int, int]) -> list[Block]:
    count = len(given_pairs)
    zeros: npt.NDArray[Any] = np.zeros(count, np.int64)
    return [
        Block(
            zeros.astype(np.uint64),
            np.array([each[0] for each in given_pairs], np.int64),
            zeros,
            zeros,
            zeros.astype(np.uint32),
            zeros.astype(np.bool_),
            [CLOCK_PAIR.pack(each[1], 500) for each in given_pairs],
        )
    ]


def header(t0_ns: int) -> JournalHeader:
    start = "2026-01-01T00:00:00Z"
    return JournalHeader(
        boot_id="b", t0_monotonic_ns=t0_ns, episode=episode(start=start), streams={}
    )


UTC = 1_767_225_600 * S  # 2026-01-01


def test_timestamps_are_exact() -> None:
    assert utc_text(UTC) == "2026-01-01T00:00:00.000000000Z"
    assert utc_text(UTC + 1) == "2026-01-01T00:00:00.000000001Z"
    assert utc_text(UTC - 1) == "2025-12-31T23:59:59.999999999Z"


def test_the_start_follows_from_the_pairs() -> None:
    epoch = epoch_of(pairs((5 * S, UTC + 5 * S), (7 * S, UTC + 7 * S + 900)), header(4 * S))
    assert epoch.start == "2026-01-01T00:00:04.000000000Z"
    assert epoch.note is None


def test_a_step_of_utc_is_noted() -> None:
    hour = 3600 * S
    epoch = epoch_of(pairs((5 * S, UTC), (7 * S, UTC + 2 * S + hour)), header(5 * S))
    assert epoch.start == "2026-01-01T01:00:00.000000000Z"
    assert epoch.note is not None
    assert epoch.note.code == "utc-stepped"
    assert "+3600.000 s" in epoch.note.message


def test_without_pairs_the_header_counts() -> None:
    assert epoch_of([], header(0)).start == "2026-01-01T00:00:00Z"


def test_times_increase_over_blocks() -> None:
    clock = Clock(source="hub_monotonic", stamp_point="kernel_rx", t_ref_ns=100, latency_ns=10)
    times = StreamTimes(clock)
    first, nudged = times.take(np.array([110, 120, 115, 130], np.int64))
    assert first.tolist() == [0, 10, 11, 20]
    assert nudged.tolist() == [False, False, True, False]
    second, nudged = times.take(np.array([130, 140], np.int64))
    assert second.tolist() == [21, 30]
    assert nudged.tolist() == [True, False]
    assert times.take(np.array([], np.int64))[0].tolist() == []


# ------------------------------------------------------------------------------------------- poses


def test_the_world_transform_is_that_of_the_matrices() -> None:
    rng = np.random.default_rng(3)
    raw, world = rng.normal(size=(20, 7)), rng.normal(size=7)
    poses, valid = to_world(raw, world)
    assert valid.all()
    swap = np.eye(3)[[0, 2, 1]]
    inside, marked = pose_to_matrix(raw), pose_to_matrix(world)
    rotation = swap @ marked[:3, :3].T @ inside[:, :3, :3] @ swap.T
    position = (inside[:, :3, 3] - marked[:3, 3]) @ marked[:3, :3] @ swap.T
    found = pose_to_matrix(poses)
    np.testing.assert_allclose(found[:, :3, :3], rotation, atol=1e-12)
    np.testing.assert_allclose(found[:, :3, 3], position, atol=1e-12)


def test_poses_that_are_none_are_marked() -> None:
    raw = np.tile(np.array(IDENTITY), (4, 1))
    raw[1, 3:] = 0
    raw[2, 0] = np.nan
    poses, valid = to_world(raw, IDENTITY)
    assert valid.tolist() == [True, False, False, True]
    assert np.isnan(poses[1:3]).all()


def test_signs_are_continuous_over_blocks_and_holes() -> None:
    signs = PoseSigns()
    poses = np.array([[0, 0, 0, 0, 0, 0, 1.0], [0, 0, 0, 0, 0, 0, -1.0]])
    first = signs.take(poses, np.array([True, True]))
    assert first[:, 6].tolist() == [1, 1]
    second = signs.take(-poses, np.array([False, True]))
    assert second[1, 6] == 1
    assert signs.take(poses, np.array([False, False])) is not None


# ------------------------------------------------------------------------------------------ widths

VALUE = {"raw_to_data": {"raw": [3600, 3800, 4000, 4200], "data": [0.0, 0.03, 0.06, 0.08]}}


def test_counts_go_on_over_the_wrap() -> None:
    known = read_width_map(VALUE)
    assert isinstance(known, WidthMap)
    widths, outside = known.widths(np.array([3600, 3700, 4095, 0, 104, 110, 3590]), 4096)
    # Beyond the ends of the map they are held.
    expected = [0, 0.015, 0.06 + 0.0095, 0.06 + 0.0096, 0.08, 0.08, 0]
    np.testing.assert_allclose(widths, expected, atol=1e-8)
    assert outside.tolist() == [False] * 5 + [True, True]


def test_the_range_that_is_stated_counts() -> None:
    known = read_width_map({**VALUE, "range_m": [0.01, 0.07]})
    assert isinstance(known, WidthMap)
    outside = known.widths(np.array([3600, 3800, 4000, 4200]), None)[1]
    assert outside.tolist() == [True, False, False, True]


@pytest.mark.parametrize(
    "value",
    [
        None,
        {},
        {"raw_to_data": 1},
        {"raw_to_data": {"raw": [1, 2]}},
        {"raw_to_data": {"raw": [1], "data": [1]}},
        {"raw_to_data": {"raw": [2, 1], "data": [0, 1]}},
        {"raw_to_data": {"raw": [1, 2], "data": [0, float("nan")]}},
        {"raw_to_data": {"raw": ["a", "b"], "data": [0, 1]}},
    ],
)
def test_what_is_no_map_is_said(value: object) -> None:
    assert isinstance(read_width_map(value), str)
