"""Orders of windows: whole, shuffled, resumable."""

from typing import Any

import numpy as np
import pytest

from exumi_data.errors import UsageError
from exumi_loaders import ActiveWindowSampler, WindowIndex, WindowSampler


class Windows:
    """As many windows as wanted, every third active."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __len__(self) -> int:
        return self.count

    @property
    def active(self) -> np.ndarray:
        return np.asarray(np.arange(self.count) % 3 == 0)


def test_every_window_once_an_epoch() -> None:
    sampler = WindowSampler(Windows(100), seed=1)
    first, second = list(sampler), list(sampler)
    assert sorted(first) == [WindowIndex(0, i) for i in range(100)]
    assert sorted(second) == [WindowIndex(1, i) for i in range(100)]
    assert [i.window for i in first] != [i.window for i in second]
    assert [i.window for i in WindowSampler(Windows(5), shuffle=False)] == [0, 1, 2, 3, 4]


def test_resume_goes_on_where_training_was() -> None:
    whole = [*(sampler := WindowSampler(Windows(50), seed=2, reject_inactive=0.5)), *sampler]
    for consumed in (0, 7, 20):
        stopped = WindowSampler(Windows(50), seed=2, reject_inactive=0.5)
        state = stopped.state_dict(consumed)
        resumed = WindowSampler(Windows(50), seed=2, reject_inactive=0.5)
        resumed.load_state_dict(state)
        assert [*resumed, *resumed] == whole[consumed:]


def test_a_state_of_another_seed_is_refused() -> None:
    state = WindowSampler(Windows(5), seed=1).state_dict(0)
    with pytest.raises(UsageError, match="seed 1"):
        WindowSampler(Windows(5), seed=2).load_state_dict(state)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (WindowSampler(Windows(6)), "windows 5"),
        (WindowSampler(Windows(5), shuffle=False), "shuffle True"),
        (WindowSampler(Windows(5), reject_inactive=0.5), r"reject_inactive 0\.0"),
    ],
)
def test_a_state_of_another_order_is_refused(other: WindowSampler, said: str) -> None:
    state = WindowSampler(Windows(5)).state_dict(0)
    with pytest.raises(UsageError, match=said):
        other.load_state_dict(state)


def test_what_is_no_state_is_refused() -> None:
    with pytest.raises(UsageError, match="no seed"):
        WindowSampler(Windows(5)).load_state_dict({})
    for consumed in (-1, 6):
        with pytest.raises(UsageError, match="of the 5"):
            WindowSampler(Windows(5)).state_dict(consumed)


@pytest.mark.parametrize("kind", [WindowSampler, ActiveWindowSampler])
@pytest.mark.parametrize("consumed", [4, 28, 30])
def test_a_sampler_that_ran_ahead_of_training_knows_the_epoch(kind: Any, consumed: int) -> None:
    """Workers prefetch: they may have asked for the last window long before training uses it."""
    whole = [*(sampler := kind(Windows(30))), *sampler]
    ahead = kind(Windows(30))
    assert len(list(ahead)) == 30
    resumed = kind(Windows(30))
    resumed.load_state_dict(ahead.state_dict(consumed))
    assert [*resumed, *resumed][: 60 - consumed] == whole[consumed : consumed + 60]


def test_the_epoch_that_is_resumed_can_be_named_again() -> None:
    """As trainers do before each epoch."""
    whole = list(WindowSampler(Windows(30)))
    resumed = WindowSampler(Windows(30))
    resumed.load_state_dict(WindowSampler(Windows(30)).state_dict(7))
    resumed.set_epoch(0)
    assert list(resumed) == whole[7:]
    resumed.set_epoch(0)
    assert list(resumed) == whole


def test_active_windows_are_never_left_out() -> None:
    windows = Windows(999)
    sampler = WindowSampler(windows, reject_inactive=1.0)
    assert sorted(i.window for i in sampler) == list(range(0, 999, 3))
    with pytest.raises(UsageError, match="reject_inactive"):
        WindowSampler(windows, reject_inactive=1.5)
