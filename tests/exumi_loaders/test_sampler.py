"""Orders of windows: whole, shuffled, resumable."""

import numpy as np
import pytest

from exumi_data.errors import UsageError
from exumi_loaders import WindowIndex, WindowSampler


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


def test_active_windows_are_never_left_out() -> None:
    windows = Windows(999)
    sampler = WindowSampler(windows, reject_inactive=1.0)
    assert sorted(i.window for i in sampler) == list(range(0, 999, 3))
    with pytest.raises(UsageError, match="reject_inactive"):
        WindowSampler(windows, reject_inactive=1.5)
