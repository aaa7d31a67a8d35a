"""Windows of several datasets: the same items as alone, drawn as their weights say."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import torch

from exumi_data.errors import UsageError
from exumi_loaders import ActiveWindowSampler, ConcatWindows, TPPWindows, WindowIndex


def seconds(rate: float, duration: float = 6.0) -> np.ndarray:
    return np.arange(round(rate * duration)) / rate


def touched(recipe: Any, duration: float = 6.0, share: float = 0.25, **changes: Any) -> Any:
    count = round(30 * duration)
    values: dict[str, Any] = {
        "tactile_s": seconds(30, duration),
        "rgb_s": seconds(30, duration),
        "pose_s": seconds(90, duration),
        "activity": np.where(np.arange(count) < share * count, 0.01, 0.0),
    }
    return recipe(**{**values, **changes})


@pytest.fixture
def parts(make_dataset: Any, recipe: Any) -> list[TPPWindows]:
    return [
        open_windows(make_dataset(touched(recipe), touched(recipe, share=1.0), name="one")),
        open_windows(make_dataset(touched(recipe, 3.0, shift=60), name="two"), seed=7),
        open_windows(make_dataset(touched(recipe, 9.0, share=0.0, encoded=True), name="three")),
    ]


def open_windows(dataset: Any, **options: Any) -> TPPWindows:
    return TPPWindows(dataset, **{"tick_s": Fraction(1, 20), "cache": False, **options})


@pytest.mark.parametrize("workers", [0, 2])
def test_items_are_those_of_the_parts(parts: list[TPPWindows], workers: int) -> None:
    joined = ConcatWindows(parts)
    assert len(joined) == 240 + 60 + 180
    expected = [(p, i) for p, part in enumerate(parts) for i in range(len(part))]
    seen = []
    loader = joined.loader(48, num_workers=workers, sampler=None, shuffle=True)
    for batch in loader:
        assert set(batch) == set(joined.spec)
        starts = torch.tensor([0, 120])
        index = batch["time_ns"] // 50_000_000 + starts[batch["episode"]]
        for row, (part, at) in enumerate(zip(batch["part"].tolist(), index.tolist(), strict=True)):
            seen.append((part, at))
            if row % 7 == 0:
                for key, value in parts[part][at].items():
                    torch.testing.assert_close(batch[key][row], value, rtol=0, atol=1e-6)
    assert sorted(seen) == expected
    assert seen != expected


def test_a_batch_is_filled_in_place(parts: list[TPPWindows]) -> None:
    joined = ConcatWindows(parts)
    for part in parts:
        part._buffers.take = None  # type: ignore[method-assign,assignment]  # none may be taken
    batch = joined.__getitems__([0, 250, 10, 479])
    assert batch["part"].tolist() == [0, 1, 0, 2]
    assert batch["tactile"].shape == (4, 8, 1, 8, 8)
    assert int(joined[-1]["part"]) == 2


def test_activity_is_that_of_the_parts(parts: list[TPPWindows]) -> None:
    joined = ConcatWindows(parts)
    np.testing.assert_array_equal(joined.active, np.concatenate([p.active for p in parts]))
    for batch in joined.loader(32, reject_inactive=1.0):
        assert not (batch["part"] == 2).any()


def shares(joined: ConcatWindows, order: np.ndarray) -> np.ndarray:
    edges = np.cumsum([0, *map(len, joined.parts)])
    return np.bincount(np.searchsorted(edges, order, side="right") - 1, minlength=3) / len(order)


def test_weights_are_shares_of_what_is_drawn(parts: list[TPPWindows]) -> None:
    joined = ConcatWindows(parts, weights=[1, 2, 5])
    assert joined.weights is not None
    assert joined.weights.sum() == pytest.approx(1)
    plain = ActiveWindowSampler(joined, reject=0.0, weights=joined.weights, count=20_000)
    np.testing.assert_allclose(shares(joined, plain.order(0)), [0.125, 0.25, 0.625], atol=0.015)
    active = ActiveWindowSampler(joined, weights=joined.weights, count=20_000).order(0)
    assert joined.active[active].all()
    # Rejection comes after the weights: a part's share is its weight times its active share.
    touching = np.array([1, 2, 5]) * [part.active.mean() for part in parts]
    np.testing.assert_allclose(shares(joined, active), touching / touching.sum(), atol=0.015)


def test_the_loader_follows_the_weights(parts: list[TPPWindows]) -> None:
    joined = ConcatWindows(parts, weights=[1, 1, 1e-9], seed=3)
    drawn = np.concatenate([batch["part"] for batch in joined.loader(60)])
    assert len(drawn) == len(joined)
    assert (drawn < 2).all()
    assert abs((drawn == 0).mean() - 0.5) < 0.12
    with pytest.raises(UsageError, match="shuffle"):
        joined.loader(60, shuffle=False)


def test_weights_need_no_activity(make_dataset: Any, recipe: Any) -> None:
    sets = [make_dataset(touched(recipe, activity=None), name=name) for name in "ab"]
    joined = ConcatWindows([open_windows(opened) for opened in sets], weights=[1, 3])
    assert len(list(joined.loader(60))) == 4
    with pytest.raises(UsageError, match="activity"):
        joined.loader(60, reject_inactive=0.5)


def test_the_epoch_reaches_the_parts(parts: list[TPPWindows]) -> None:
    joined = ConcatWindows(parts)
    later = joined.__getitems__([WindowIndex(5, 20), WindowIndex(5, 245)])
    for part in parts:
        part.set_epoch(5)
    assert torch.equal(later["tactile_steps"][0], parts[0][20]["tactile_steps"])
    assert torch.equal(later["tactile_steps"][1], parts[1][5]["tactile_steps"])
    joined.set_epoch(5)
    assert torch.equal(joined[20]["tactile_steps"], later["tactile_steps"][0])


def test_parts_that_differ_are_refused_by_key(make_dataset: Any, recipe: Any) -> None:
    first = make_dataset(touched(recipe), name="first")
    for name, changes, options, words in (
        ("size", {"side": 10}, {}, r"'tactile' is \(8, 1, 8, 8\) uint8 in part 0 and \(8, 1, 10"),
        ("colour", {"channels": 3}, {}, r"'tactile' is .* and \(8, 3, 8, 8\)"),
        ("width", {"width_s": seconds(200)}, {}, r"'action' is \(32, 9\) .* \(32, 10\)"),
        ("camera", {"rgb_s": None}, {}, "part 0 has 'rgb', part 1 has not"),
        ("span", {}, {"future": 8}, r"'action' is \(32, 9\) .* \(24, 9\)"),
        ("tick", {}, {"tick_s": Fraction(1, 10)}, "tick_s: 1/20 in part 0 and 1/10"),
        ("tool", {"child": "flange"}, {}, "child frames: .*'tcp'.* and .*'flange'"),
        ("policy", {}, {"on_corrupt": "skip"}, "part 1 has 'replaced', part 0 has not"),
    ):
        other = make_dataset(touched(recipe, **changes), name=name)
        with pytest.raises(UsageError, match=words):
            ConcatWindows([open_windows(first), open_windows(other, **options)])
    with pytest.raises(UsageError, match="no windows"):
        ConcatWindows([])
    windows = open_windows(first)
    for weights in ([1], [1, 0], [1, -1], [1, float("nan")]):
        with pytest.raises(UsageError, match="one a part"):
            ConcatWindows([windows, windows], weights=weights)
