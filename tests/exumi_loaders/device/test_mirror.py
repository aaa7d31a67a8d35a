"""Mirror images of scenes: twice is nothing, motions still compose, and the simulator agrees."""

from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from exumi_data import geometry
from exumi_data.errors import UsageError
from exumi_data.simulation import simulate_play
from exumi_data.simulation.camera import make_camera
from exumi_data.simulation.gel import Contact
from exumi_data.simulation.gel_look import make_pad
from exumi_data.simulation.objects import height_map, object_by_name
from exumi_loaders import Mirror
from exumi_loaders.device import mirror_relative_poses
from exumi_loaders.device.image_module import Batch

WHITE = {"tactile_left": "9dtact", "tactile_right": "9dtact"}
LIT = {"tactile": "gelsight-mini"}


def poses(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.normal(size=(count, 3)))
    return np.concatenate((rng.normal(size=(count, 3)), turn.as_quat()), axis=1)


def nine(pose: np.ndarray) -> torch.Tensor:
    """xyz and two rows of the rotation matrix."""
    return torch.from_numpy(
        np.concatenate((pose[..., :3], geometry.rotation_6d(pose[..., 3:])), axis=-1)
    )


def make_batch(windows: int = 6) -> Batch:
    generator = torch.Generator().manual_seed(0)

    def images(frames: int) -> torch.Tensor:
        return torch.randint(
            0, 256, (windows, frames, 1, 6, 5), generator=generator, dtype=torch.uint8
        )

    batch: Batch = {"rgb": images(1), "rgb_valid": torch.ones(windows, 1, dtype=torch.bool)}
    for side in ("left", "right"):
        name = f"tactile_{side}"
        batch[name] = images(3)
        batch[f"{name}_reference"] = images(1)[:, 0]
        batch[f"{name}_valid"] = torch.rand(windows, 3, generator=generator) < 0.5
    batch["action"] = torch.rand(windows, 32, 10, generator=generator)
    batch["tactile_steps"] = torch.arange(3).expand(windows, 3)
    return batch


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_poses_are_mirrored_by_the_definition(axis: Any) -> None:
    """M·T·M by matrices, for seven numbers, and for nine."""
    matrix = np.eye(4)
    number = "xyz".index(axis)
    matrix[number, number] = -1
    pose = poses(50)
    expected = matrix @ geometry.pose_to_matrix(pose) @ matrix
    mirrored = geometry.mirror(pose, axis)
    np.testing.assert_allclose(geometry.pose_to_matrix(mirrored), expected, atol=1e-12)
    rows = np.concatenate((expected[:, :3, 3], expected[:, :2, :3].reshape(-1, 6)), axis=1)
    np.testing.assert_allclose(mirror_relative_poses(nine(pose), axis), rows, atol=1e-12)
    np.testing.assert_array_equal(geometry.mirror(mirrored, axis), pose)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_mirroring_commutes_with_composing(axis: Any) -> None:
    first, second = poses(50, 1), poses(50, 2)

    def mirrored(pose: np.ndarray) -> np.ndarray:
        return geometry.mirror(pose, axis)

    for chain in (geometry.compose, geometry.relative):
        before = geometry.pose_to_matrix(chain(mirrored(first), mirrored(second)))
        after = geometry.pose_to_matrix(mirrored(chain(first, second)))
        np.testing.assert_allclose(before, after, atol=1e-9)
    # So actions may be mirrored after they were made relative to step 0.
    relative = nine(geometry.relative(first, second))
    np.testing.assert_allclose(
        mirror_relative_poses(relative, axis),
        nine(geometry.relative(mirrored(first), mirrored(second))),
        atol=1e-9,
    )


def test_no_such_axis() -> None:
    with pytest.raises(ValueError, match="axis"):
        geometry.mirror(poses(1), "w")  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(UsageError, match="axis"):
        Mirror(WHITE, axis="w")  # type: ignore[arg-type]


def test_twice_is_the_identity() -> None:
    batch = make_batch()
    for options in ({}, {"axis": "y", "swap": (), "tactile_flip": "vertical"}):
        mirror = Mirror(WHITE, p=1.0, **options)  # type: ignore[arg-type]  # mixed values
        once = mirror(batch)
        twice = mirror(once)
        assert not torch.equal(once["tactile_left"], batch["tactile_left"])
        assert all(torch.equal(twice[name], batch[name]) for name in batch)


def test_fingers_change_places_with_all_that_is_theirs() -> None:
    batch = make_batch()
    done = Mirror(WHITE, p=1.0)(batch)
    assert torch.equal(done["rgb"], batch["rgb"].flip(-1))
    for own, other in (("left", "right"), ("right", "left")):
        new, old = f"tactile_{own}", f"tactile_{other}"
        assert torch.equal(done[new], batch[old].flip(-1))
        assert torch.equal(done[f"{new}_reference"], batch[f"{old}_reference"].flip(-1))
        assert torch.equal(done[f"{new}_valid"], batch[f"{old}_valid"])
    assert torch.equal(done["action"][..., 9], batch["action"][..., 9])  # the width
    assert torch.equal(
        done["action"][..., :9], mirror_relative_poses(batch["action"][..., :9], "x")
    )
    assert done["tactile_steps"] is batch["tactile_steps"]
    assert done["rgb_valid"] is batch["rgb_valid"]


def test_a_window_is_mirrored_as_a_whole_or_not_at_all() -> None:
    batch = make_batch(200)
    done = Mirror(WHITE, p=0.5, seed=1)(batch)
    mirrored = (done["action"] != batch["action"]).flatten(1).any(dim=1)
    assert 70 < mirrored.sum() < 130
    whole = Mirror(WHITE, p=1.0)(batch)
    for name in batch:
        for window in range(200):
            expected = (whole if mirrored[window] else batch)[name][window]
            assert torch.equal(done[name][window], expected)
    again = Mirror(WHITE, p=0.5, seed=1)(batch)
    assert all(torch.equal(again[name], done[name]) for name in batch)


def test_one_image_of_both_fingers_is_flipped_as_one() -> None:
    """Left turned left and right turned right, side by side: the flip swaps and turns them."""
    left, right = torch.rand(2, 4, 1, 1, 8, 6).unbind()

    def combined(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return torch.cat((a.rot90(1, (-2, -1)), b.rot90(-1, (-2, -1))), dim=-1)

    mirror = Mirror(WHITE, p=1.0)
    apart = mirror({"tactile_left": left, "tactile_right": right})
    one = Mirror({"tactile_combined": "9dtact"}, p=1.0)({"tactile_combined": combined(left, right)})
    expected = combined(apart["tactile_left"], apart["tactile_right"])
    assert torch.equal(one["tactile_combined"], expected)


@pytest.mark.parametrize("model", ["gelsight-mini", "digit", "some-gel", None])
def test_gels_of_coloured_or_unknown_light_are_refused(model: str | None) -> None:
    with pytest.raises(UsageError, match="any_light=True") as caught:
        Mirror({"tactile": model})
    assert caught.value.where == "tactile"
    assert Mirror({"tactile": model}, any_light=True, p=1.0)(
        {"tactile": torch.rand(1, 1, 3, 4, 4)}
    )["tactile"].shape == (1, 1, 3, 4, 4)


def test_sensors_are_read_from_the_episodes(make_dataset: Any, recipe: Any) -> None:
    from exumi_loaders import TPPWindows

    second = np.arange(0, 3, 1 / 30)
    dataset = make_dataset(recipe(tactile_s=second, pose_s=second))
    windows = TPPWindows(dataset, cache=False)
    with pytest.raises(UsageError, match="not said which sensor"):
        Mirror.of(windows)  # these test episodes name no sensor
    mirror = Mirror.of(windows, any_light=True, p=1.0)
    batch = windows.__getitems__([10, 20])
    done = mirror(batch)
    assert torch.equal(done["tactile"], batch["tactile"].flip(-1))
    assert torch.equal(done["action"], mirror_relative_poses(batch["action"], "x"))


def test_what_is_not_known_is_not_forgotten() -> None:
    batch = make_batch()
    batch["proprioception"] = torch.rand(6, 4, 9)
    with pytest.raises(UsageError, match="'proprioception'"):
        Mirror(WHITE)(batch)
    done = Mirror(WHITE, p=1.0, poses={"action": (0,), "proprioception": (0,)})(batch)
    expected = mirror_relative_poses(batch["proprioception"], "x")
    assert torch.equal(done["proprioception"], expected)
    kept = Mirror(WHITE, p=1.0, unchanged=["proprioception"])(batch)
    assert kept["proprioception"] is batch["proprioception"]


def test_a_finger_alone_has_nobody_to_change_places_with() -> None:
    batch = make_batch()
    del batch["tactile_right"]
    with pytest.raises(UsageError, match="'tactile_right'"):
        Mirror(WHITE)(batch)
    batch["tactile_right"] = torch.zeros(6, 3, 1, 5, 6, dtype=torch.uint8)
    with pytest.raises(UsageError, match="change places"):
        Mirror(WHITE)(batch)
    with pytest.raises(UsageError, match="no images"):
        Mirror(WHITE)({"action": torch.zeros(1, 32, 10)})


# ------------------------------------------------------------------------------- the simulator


def test_the_simulated_wrist_camera_sees_the_mirrored_scene_flipped() -> None:
    """Points of a mirrored world, seen from the mirrored gripper, are where the flip puts them."""
    camera = make_camera((48, 64), seed=0)
    rng = np.random.default_rng(0)
    gripper = np.array([0.1, -0.05, 0.3, *Rotation.from_rotvec([2.9, 0.3, 0.2]).as_quat()])
    local = rng.uniform((-0.05, -0.05, 0.05), (0.05, 0.05, 0.2), (30, 3))
    points = (geometry.pose_to_matrix(gripper) @ np.c_[local, np.ones(30)].T).T[:, :3]
    seen = camera.project(gripper, points)
    mirrored = camera.project(geometry.mirror(gripper, "x"), points * (-1, 1, 1))
    np.testing.assert_allclose(mirrored[:, 0], 63 - seen[:, 0], atol=1e-9)
    np.testing.assert_allclose(mirrored[:, 1:], seen[:, 1:], atol=1e-9)


def test_the_simulated_fingers_are_mirror_images() -> None:
    """In the mirrored scene each finger feels, flipped, what the other one feels here.

    The fingers of the simulated gripper are mirror images, and a mirror across x leaves the place
    of the object in the grip as it is. So what the left finger would feel in the mirrored scene is
    where the simulator puts the contact on the left finger, with the object mirrored.
    """
    truth = simulate_play(seed=2, duration_s=12.0).truth
    time = np.linspace(0, 12, 600)
    time = time[truth.in_contact(time)]
    left, right = (truth.contact_pose(finger, time) for finger in ("left", "right"))
    assert len(time) > 50
    np.testing.assert_allclose(left, right * (-1, 1, -1), atol=1e-12)
    shear_left, shear_right = (truth.skin_shear(f, time) for f in ("left", "right"))
    np.testing.assert_allclose(shear_left, shear_right * (-1, 1, -1), atol=1e-12)


@pytest.mark.parametrize("name", ["bolt", "key", "strawberry"])
def test_a_mirrored_simulated_contact_is_the_flipped_one(name: str) -> None:
    pad = make_pad((60, 80), dotted=False, seed=0)
    heights = height_map(object_by_name(name), "right", pad.m_per_px)
    contact = Contact(0.8e-3, 1.5e-3, -1.0e-3, 0.4)
    mirrored = Contact(0.8e-3, -1.5e-3, -1.0e-3, -0.4)
    skin = pad.indentation_mm(heights, contact)
    skin_mirrored = pad.indentation_mm(np.ascontiguousarray(heights[:, ::-1]), mirrored)
    # What a gel shows that is lit evenly from everywhere: how deep it is pressed in.
    scene, mirror_scene = (
        torch.from_numpy(depth / 1.5)[None, None, None].float() for depth in (skin, skin_mirrored)
    )
    nothing = torch.zeros_like(scene)
    done = Mirror(WHITE, p=1.0)({"tactile_left": nothing, "tactile_right": scene})
    assert skin.max() > 0.5
    # OpenCV interpolates at 1/32 px, from the left in both scenes.
    assert (done["tactile_left"] - mirror_scene).abs().max() < 0.05
    assert (done["tactile_left"] - mirror_scene).abs().mean() < 2e-3
    assert (done["tactile_right"] == 0).all()


def test_a_flipped_image_of_coloured_light_is_none_that_the_sensor_makes() -> None:
    """Why such sensors are refused: the same mirrored contact, with the lights where they are."""
    pad = make_pad((60, 80), dotted=False, seed=0)
    heights = height_map(object_by_name("ball"), "right", pad.m_per_px)
    here = pad.render(heights, Contact(0.8e-3, 1.5e-3, 0.0, 0.0), 0).astype(float)
    there = pad.render(heights[:, ::-1].copy(), Contact(0.8e-3, -1.5e-3, 0.0, 0.0), 0)
    flipped = Mirror(LIT, p=1.0, any_light=True)(
        {"tactile": torch.from_numpy(here).movedim(-1, 0)[None, None]}
    )["tactile"][0, 0]
    difference = np.abs(flipped.movedim(0, -1).numpy() - there)
    assert np.percentile(difference, 99) > 40
