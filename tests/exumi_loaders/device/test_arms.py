"""Two arms in a mirror: what the windows of the mirrored scene hold."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from exumi_data import geometry
from exumi_data.errors import UsageError
from exumi_loaders import ConcatWindows, Mirror, TPPWindows
from exumi_loaders.device.arms import Arms, arms_of, other_side, pose_columns, side_pairs
from exumi_loaders.device.mirror import mirror_relative_poses
from exumi_loaders.layout import Layout

SECONDS = np.arange(0, 4, 1 / 30)
ZERO = 15
MASKED = {"mask": "action"}


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("pose_left", "pose_right"),
        ("right", "left"),
        ("tactile_left_right", "tactile_right_left"),
        ("left2", "right2"),
        ("rgb_bright", "rgb_bright"),
        ("rgb", "rgb"),
    ],
)
def test_the_other_side_of_a_name(name: str, other: str) -> None:
    assert other_side(name) == other
    assert other_side(other) == name


def test_names_are_paired() -> None:
    names = ["tactile_left_left", "tactile_left_right", "tactile_right_left", "tactile_right_right"]
    pairs = side_pairs([*names, "rgb_left", "rgb"])
    assert pairs == dict(zip(names, reversed(names), strict=True))


# ---------------------------------------------------------------------- against the mirrored scene


def walk(seed: int, count: int) -> np.ndarray:
    """A motion of one arm, (count, 7)."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(scale=0.05, size=(count, 6)).cumsum(axis=0) + rng.normal(size=6)
    return np.concatenate((steps[:, :3], Rotation.from_rotvec(steps[:, 3:]).as_quat()), axis=1)


def nine(poses: np.ndarray) -> np.ndarray:
    return np.concatenate((poses[..., :3], geometry.rotation_6d(poses[..., 3:])), axis=-1)


def window_of(poses: np.ndarray, measured: np.ndarray) -> dict[str, torch.Tensor]:
    """What windows hold of the poses (G, B, S, 7) of some arms, by their definition."""
    start = poses[:, :, ZERO : ZERO + 1]
    action = np.concatenate(list(nine(geometry.relative(start, poses))), axis=-1)
    others = nine(geometry.relative(start[:1], poses[1:]))
    at_zero = measured[:, :, ZERO : ZERO + 1]
    batch = {
        "tactile": np.zeros((poses.shape[1], 1, 1, 2, 2), np.uint8),
        "action": action,
        "action_valid": (measured & at_zero).all(axis=0),
        "between": np.concatenate(list(others), axis=-1),
        "between_valid": measured[1:].all(axis=0) & at_zero[0],
    }
    return {name: torch.from_numpy(value) for name, value in batch.items()}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "names",
    [
        ("pose_left", "pose_right"),
        ("pose_right", "pose_left"),
        ("a_left", "b_right", "a_right", "b_left"),
        ("b_left", "a_left", "b_right", "a_right"),
    ],
)
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_arms_change_places_as_in_the_mirrored_scene(
    seed: int, names: tuple[str, ...], axis: Any
) -> None:
    """The world is mirrored at any plane, and every arm becomes its partner."""
    count = len(names)
    poses = np.stack([walk(seed * 10 + arm, 6 * 32).reshape(6, 32, 7) for arm in range(count)])
    measured = np.random.default_rng(seed).random((count, 6, 32)) < 0.9
    measured[:, :3, ZERO] = True
    partner = [names.index(other_side(name)) for name in names]
    layout = Layout(("tactile",), (), names)
    arms = arms_of(layout, zero=ZERO)
    assert arms is not None
    assert arms.partner == tuple(partner)
    mirror = Mirror(
        {"tactile": "9dtact"},
        p=1.0,
        axis=axis,
        arms=arms,
        poses={"action": pose_columns(layout), "between": range(0, 9 * (count - 1), 9)},
    )
    batch = window_of(poses, measured)
    done = mirror(batch)
    expected = window_of(geometry.mirror(poses, axis)[partner], measured[partner])
    for name in ("action", "between"):
        torch.testing.assert_close(done[name], expected[name], atol=1e-9, rtol=0)
    assert torch.equal(done["action_valid"], expected["action_valid"])
    # Less may be known of where the new first arm was measured, never more.
    assert not (done["between_valid"] & ~expected["between_valid"]).any()
    known = expected["between_valid"] & batch["action_valid"] & batch["between_valid"][:, [ZERO]]
    assert torch.equal(done["between_valid"], known)
    assert done["between_valid"].any()
    twice = mirror(done)
    for name in ("action", "between"):
        torch.testing.assert_close(twice[name], batch[name], atol=1e-9, rtol=0)


def scene(recipe: Any, *, mirrored: bool) -> Any:
    """An episode of two arms, or of the same two in a mirror."""
    seconds = SECONDS
    poses = {f"pose_{side}": walk(number, len(seconds)) for number, side in enumerate("ab")}
    left, right = poses.values()
    widths = (0.0, 0.3)
    if mirrored:
        left, right = geometry.mirror(right, "x"), geometry.mirror(left, "x")
        widths = (0.3, 0.0)
    return recipe(
        extra={"tactile_left": seconds, "tactile_right": seconds},
        extra_rgb={"rgb_left": seconds, "rgb_right": seconds, "scene": seconds},
        pose_s=seconds,
        poses={"pose_left": left, "pose_right": right},
        width_s=seconds,
        grippers=dict(zip(("left", "right"), widths, strict=True)),
    )


@pytest.fixture
def options() -> dict[str, Any]:
    return {"tick_s": Fraction(1, 20), "cache": False, "start_noise_m": 0.0, "start_noise_rad": 0.0}


@pytest.mark.parametrize("changes", [{}, {"pose": ("pose_right", "pose_left")}, MASKED])
def test_windows_of_the_mirrored_scene(
    make_dataset: Any, recipe: Any, options: dict[str, Any], changes: dict[str, Any]
) -> None:
    options = {**options, **changes, "proprioception": True}
    here = TPPWindows(make_dataset(scene(recipe, mirrored=False), name="here"), **options)
    there = TPPWindows(make_dataset(scene(recipe, mirrored=True), name="there"), **options)
    mirror = Mirror.of(here, any_light=True, p=1.0)
    indices = range(len(here))
    batch, expected = here.__getitems__(indices), there.__getitems__(indices)
    done = mirror(batch)
    assert done.keys() == expected.keys()
    for name in ("action", "proprioception", "between"):
        torch.testing.assert_close(done[name], expected[name], atol=1e-5, rtol=0)
        assert torch.equal(done[f"{name}_valid"], expected[f"{name}_valid"])
        assert done[name].any() or changes is MASKED
    for name, other in (("rgb_left", "rgb_right"), ("tactile_left", "tactile_right")):
        assert torch.equal(done[name], batch[other].flip(-1))
        assert torch.equal(done[f"{name}_valid"], batch[f"{other}_valid"])
    assert torch.equal(done["scene"], batch["scene"].flip(-1))


def test_one_gripper_with_proprioception(
    make_dataset: Any, recipe: Any, options: dict[str, Any]
) -> None:
    """A left gripper that is alone stays what it is."""
    options = {**options, "proprioception": True, "pose": "pose_left", "width": "width_left"}
    windows = TPPWindows(make_dataset(scene(recipe, mirrored=False)), **options)
    batch = windows.__getitems__([20, 40])
    done = Mirror.of(windows, any_light=True, p=1.0)(batch)
    for name in ("action", "proprioception"):
        assert torch.equal(done[name][..., :9], mirror_relative_poses(batch[name][..., :9], "x"))
        assert torch.equal(done[name][..., 9], batch[name][..., 9])


def test_windows_of_several_datasets(
    make_dataset: Any, recipe: Any, options: dict[str, Any]
) -> None:
    parts = [
        TPPWindows(make_dataset(scene(recipe, mirrored=one), name=str(one)), **options)
        for one in (False, True)
    ]
    both = ConcatWindows(parts)
    done = Mirror.of(both, any_light=True, p=1.0)(both.__getitems__([20]))
    expected = parts[1].__getitems__([20])
    torch.testing.assert_close(done["between"], expected["between"], atol=1e-5, rtol=0)
    with pytest.raises(UsageError, match="not said which sensor"):
        Mirror.of(both)


def test_widths_without_poses_change_places(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(scene(recipe, mirrored=False))
    windows = TPPWindows(dataset, pose=(), cache=False)
    batch = windows.__getitems__([20])
    done = Mirror.of(windows, any_light=True, p=1.0)(batch)
    assert torch.equal(done["action"], batch["action"].flip(-1))
    assert not torch.equal(done["action"], batch["action"])


# ------------------------------------------------------------------------------------- refused


@pytest.mark.parametrize(
    ("layout", "match"),
    [
        (Layout(("tactile",), (), ("pose_a", "pose_b")), "'pose_a' has no partner"),
        (Layout(("tactile",), (), ("pose_left", "pose_right", "torso")), "'torso' has no partner"),
        (Layout(("tactile",), (), ("pose_left",), ("jaw_a", "jaw_b")), "has no partner"),
        (Layout(("tactile",), (), ("pose_left", "pose_right"), ("width_left",)), "has a width"),
        (Layout((), ("rgb_left",), ("pose_left", "pose_right")), "no 'rgb_right'"),
        (Layout(("tactile_right",), ("rgb",), ("pose_left", "pose_right")), "no 'tactile_left'"),
    ],
)
def test_arms_without_a_partner_are_refused(layout: Layout, match: str) -> None:
    with pytest.raises(UsageError, match=match) as caught:
        arms_of(layout, zero=ZERO)
    assert caught.value.fix


def test_one_gripper_has_no_arms_to_exchange() -> None:
    assert arms_of(Layout(("tactile_left",), (), ("pose",), ("width",)), zero=ZERO) is None
    assert arms_of(Layout(("tactile",), ()), zero=ZERO) is None


def test_poses_between_arms_need_the_action() -> None:
    arms = Arms((9, 0), (0, 9), (1, 0), ZERO)
    with pytest.raises(UsageError, match="'between' cannot be mirrored without action, action_val"):
        arms.exchanged({"between": torch.zeros(1, 32, 9)}, "between")
