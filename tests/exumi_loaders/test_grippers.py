"""Windows of several grippers: which streams belong together, and how they lie to one another."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import exumi_data
from exumi_data.errors import UsageError
from exumi_data.geometry import compose, relative, rotation_6d
from exumi_loaders import TPPWindows
from exumi_loaders.layout import Gripper, Layout

STEPS = np.arange(-15, 17)


def seconds(rate: float) -> np.ndarray:
    return np.arange(round(rate * 6)) / rate


def two_grippers(recipe: Any, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "tactile_s": seconds(30),
        "pose_s": seconds(90),
        "width_s": seconds(200),
        "grippers": {"left": 0.0, "right": 0.3},
    }
    return recipe(**{**values, **changes})


def open_windows(dataset: exumi_data.Dataset, **options: Any) -> TPPWindows:
    return TPPWindows(dataset, tick_s=Fraction(1, 20), cache=False, **options)


def test_all_grippers_are_taken_one_after_the_other(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(two_grippers(recipe))
    windows = open_windows(dataset)
    item = windows[50]
    assert item["action"].shape == (32, 20)
    assert windows.action_columns[:4] == (
        "pose_left.x",
        "pose_left.y",
        "pose_left.z",
        "pose_left.r00",
    )
    assert windows.action_columns[9:11] == ("width_left", "pose_right.x")
    for side, first in (("left", 0), ("right", 10)):
        alone = open_windows(dataset, pose=f"pose_{side}", width=f"width_{side}")
        assert alone.action_columns == windows.action_columns[first : first + 10]
        np.testing.assert_array_equal(alone[50]["action"], item["action"][:, first : first + 10])
        assert "between" not in alone[50]


def test_a_headset_is_no_gripper_unless_it_is_named(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(two_grippers(recipe, headset=True))
    windows = open_windows(dataset)
    assert windows.layout.pose == ("pose_left", "pose_right")
    named = open_windows(dataset, pose=["headset", "pose_left"], width="width_left")
    assert named.layout.pose == ("headset", "pose_left")


def test_the_second_gripper_is_seen_from_the_first_at_step_zero(
    make_dataset: Any, recipe: Any
) -> None:
    windows = open_windows(make_dataset(two_grippers(recipe)))
    item = windows[50]
    left = np.asarray(windows.timeline.low["pose_left"])[50 + STEPS]
    right = np.asarray(windows.timeline.low["pose_right"])[50 + STEPS]
    np.testing.assert_allclose(right[:, 0] - left[:, 0], 0.3)
    expected = relative(left[15], right)
    np.testing.assert_allclose(item["between"][:, :3], expected[:, :3], atol=1e-6)
    np.testing.assert_allclose(item["between"][:, 3:], rotation_6d(expected[:, 3:]), atol=1e-6)
    np.testing.assert_allclose(compose(left[15], expected[31])[:3], right[31, :3], atol=1e-9)
    assert item["between_valid"].all()
    assert windows.between_columns[0] == "pose_right.x"
    at_the_edge = windows[0]
    np.testing.assert_array_equal(at_the_edge["between_valid"], STEPS >= 0)


def test_order_is_as_asked_for(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(
        make_dataset(two_grippers(recipe)), pose=("pose_right", "pose_left"), width="width_left"
    )
    assert windows.layout.grippers == (
        Gripper("pose_right", None),
        Gripper("pose_left", "width_left"),
    )
    assert windows[3]["action"].shape == (32, 19)


@pytest.mark.parametrize(
    ("pose", "width", "expected"),
    [
        (("pose",), ("width",), [("pose", "width")]),
        (("tcp",), ("jaw",), [("tcp", "jaw")]),
        (
            ("pose_a", "pose_b"),
            ("width_b", "width_a"),
            [("pose_a", "width_a"), ("pose_b", "width_b")],
        ),
        (("pose_a", "pose_b"), ("width",), [("pose_a", None), ("pose_b", None), (None, "width")]),
        (("pose_a", "tcp"), ("jaw", "width_a"), [("pose_a", "width_a"), ("tcp", "jaw")]),
        ((), ("width",), [(None, "width")]),
        (("pose",), (), [("pose", None)]),
    ],
)
def test_poses_and_widths_are_paired_by_name(
    pose: tuple[str, ...], width: tuple[str, ...], expected: list[Any]
) -> None:
    assert [tuple(g) for g in Layout((), (), pose, width).grippers] == expected


def test_unrelated_parents_are_refused(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(two_grippers(recipe, parents={"pose_right": "other_world"}))
    with pytest.raises(UsageError, match="different parent frames"):
        open_windows(dataset)
    assert open_windows(dataset, pose="pose_right")[0]["action"].shape == (32, 11)


def test_tool_frames_are_not_mixed(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(two_grippers(recipe), two_grippers(recipe, child="flange"))
    with pytest.raises(UsageError, match="'flange'"):
        open_windows(dataset)


def test_a_stream_named_twice_is_refused(make_dataset: Any, recipe: Any) -> None:
    with pytest.raises(UsageError, match="twice"):
        open_windows(make_dataset(two_grippers(recipe)), pose=("pose_left", "pose_left"))


def test_grippers_survive_the_cache(make_dataset: Any, recipe: Any, tmp_path: Any) -> None:
    dataset = make_dataset(two_grippers(recipe))
    first, second = (TPPWindows(dataset, cache=tmp_path / "cache") for _ in range(2))
    assert first.layout == second.layout
    np.testing.assert_array_equal(first[40]["between"], second[40]["between"])
    np.testing.assert_array_equal(first.timeline.roots, second.timeline.roots)
    assert bytes(first.timeline.roots[0]).hex() == dataset[0].root_sha256
