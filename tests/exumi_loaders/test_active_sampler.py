"""Sampling by activity: the distribution of the loop that decodes, at no cost."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from exumi_data.errors import UsageError
from exumi_loaders import ActiveWindowSampler, WindowIndex


class Windows:
    """A tenth of them active, unevenly placed."""

    def __init__(self, count: int, share: float = 0.1) -> None:
        self.active = np.random.default_rng(5).random(count) < share

    def __len__(self) -> int:
        return len(self.active)


def decode_and_reject(
    windows: Windows,
    *,
    reject: float,
    retries: int | None,
    weights: np.ndarray | None,
    count: int,
) -> np.ndarray:
    """The loop as it is meant: what a loader does that learns of activity by decoding."""
    rng = np.random.default_rng(11)
    edges = np.cumsum(np.ones(len(windows)) if weights is None else weights)
    ended = []
    for _ in range(count):
        tries = 0
        while True:
            index = int(np.searchsorted(edges, rng.random() * edges[-1], side="right"))
            if windows.active[index] or rng.random() >= reject or tries == retries:
                break
            tries += 1
        ended.append(index)
    return np.array(ended)


@pytest.mark.parametrize(
    ("reject", "retries", "weighted"),
    [(0.9, 5, False), (1.0, None, False), (0.5, 0, False), (0.9, None, True), (1.0, 2, True)],
)
def test_the_distribution_is_that_of_the_loop(
    reject: float, retries: int | None, weighted: bool
) -> None:
    windows = Windows(40, share=0.2)
    weights = np.linspace(0.0, 2.0, 40) if weighted else None
    loop = decode_and_reject(windows, reject=reject, retries=retries, weights=weights, count=20_000)
    sampler = ActiveWindowSampler(
        windows, reject=reject, retries=retries, weights=weights, count=20_000
    )
    counts = [np.bincount(drawn, minlength=40) for drawn in (loop, sampler.order(0))]
    table = np.stack(counts)[:, np.sum(counts, axis=0) > 0]
    assert stats.chi2_contingency(table).pvalue > 1e-3
    share = windows.active[sampler.order(1)].mean()
    assert share == pytest.approx(sampler.active_share, abs=0.02)


def test_the_test_would_notice_another_distribution() -> None:
    windows = Windows(40, share=0.2)
    loop = decode_and_reject(windows, reject=0.9, retries=5, weights=None, count=20_000)
    other = ActiveWindowSampler(windows, reject=0.9, retries=4, count=20_000)
    table = np.stack([np.bincount(d, minlength=40) for d in (loop, other.order(0))])
    assert stats.chi2_contingency(table).pvalue < 1e-3


def test_with_exumis_figures_62_percent_of_what_comes_is_inactive() -> None:
    windows = Windows(0)
    windows.active = np.arange(1000) < 100
    sampler = ActiveWindowSampler.exumi(windows)
    assert 1 - sampler.active_share == pytest.approx(0.624, abs=0.01)


def test_by_default_every_window_is_active() -> None:
    windows = Windows(500)
    assert windows.active[ActiveWindowSampler(windows).order(3)].all()


@given(st.integers(1, 7), st.integers(1, 60), st.integers(0, 3))
def test_ranks_share_the_slots_out(world: int, count: int, epoch: int) -> None:
    windows = Windows(97)
    whole = ActiveWindowSampler(windows, count=-(-count // world) * world).order(epoch)
    ranks = [
        ActiveWindowSampler(windows, count=count, rank=rank, world_size=world)
        for rank in range(world)
    ]
    assert {len(rank) for rank in ranks} == {len(whole) // world}
    for rank, sampler in enumerate(ranks):
        np.testing.assert_array_equal(sampler.order(epoch), whole[rank::world])


def test_blocks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    sampler = ActiveWindowSampler(Windows(300))
    whole = sampler.order(0)
    monkeypatch.setattr("exumi_loaders.active_sampler._BLOCK", 7)
    np.testing.assert_array_equal(sampler.order(0), whole)


def test_resume_goes_on_where_training_was_also_with_other_ranks() -> None:
    windows = Windows(120)
    whole = [*(sampler := ActiveWindowSampler(windows, seed=2)), *sampler]
    for consumed in (0, 8, 60):
        ranks = [ActiveWindowSampler(windows, seed=2, rank=r, world_size=2) for r in range(2)]
        state = ranks[0].state_dict(consumed)
        resumed = ActiveWindowSampler(windows, seed=2)
        resumed.load_state_dict(state)
        left = whole[2 * consumed :]
        assert [*resumed, *resumed][: len(left)] == left
        assert whole[0] == WindowIndex(0, whole[0].window)


def test_a_state_that_does_not_fit_is_refused() -> None:
    windows = Windows(100)
    state = ActiveWindowSampler(windows, seed=1).state_dict(3)
    with pytest.raises(UsageError, match="seed 1"):
        ActiveWindowSampler(windows, seed=2).load_state_dict(state)
    with pytest.raises(UsageError, match="active_share"):
        ActiveWindowSampler(windows, seed=1, reject=0.5).load_state_dict(state)
    with pytest.raises(UsageError, match="no multiple of 2 ranks"):
        ActiveWindowSampler(windows, seed=1, world_size=2).load_state_dict(state)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"reject": 1.5}, "reject"),
        ({"retries": -1}, "retries"),
        ({"count": 0}, "count"),
        ({"rank": 2, "world_size": 2}, "rank"),
        ({"weights": [1.0]}, "shape"),
        ({"weights": np.full(100, -1.0)}, "negative"),
        ({"weights": np.zeros(100)}, "no window to draw"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, object], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        ActiveWindowSampler(Windows(100), **options)  # type: ignore[arg-type]  # on purpose


def test_nothing_active_is_said_and_not_looped_over() -> None:
    windows = Windows(10, share=0.0)
    with pytest.raises(UsageError, match="no window is active"):
        ActiveWindowSampler(windows)
    assert len(ActiveWindowSampler(windows, retries=5).order(0)) == 10
