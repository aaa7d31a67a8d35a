"""Which calibration items a stream's numbers depend on."""

from typing import Any

import pytest

from exumi_loaders.calibration import calibration_digest, calibration_items

NAMES = (
    "intrinsics/rgb",
    "T_gripper_rgb",
    "intrinsics/left_rgb",
    "rectification/tactile",
    "tactile_reference/tactile",
    "width_encoder",
    "tcp",
)


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        ("rgb", ["T_gripper_rgb", "intrinsics/rgb"]),
        ("left_rgb", ["intrinsics/left_rgb"]),
        ("tactile", ["rectification/tactile"]),
        ("width", ["width_encoder"]),
        ("pose", ["tcp"]),
    ],
)
def test_items_are_found_by_name(
    make_dataset: Any, recipe: Any, stream: str, expected: list[str]
) -> None:
    times = [0.0, 0.1]
    dataset = make_dataset(
        recipe(
            tactile_s=times,
            rgb_s=times,
            pose_s=times,
            width_s=times,
            extra_rgb={"left_rgb": times},
            calibration={name: [1.0] for name in NAMES},
        )
    )
    assert calibration_items(dataset[0].metadata, stream) == expected


def test_another_lens_has_another_digest(make_dataset: Any, recipe: Any) -> None:
    times = [0.0, 0.1]
    dataset = make_dataset(
        *(recipe(rgb_s=times, pose_s=times, calibration={"intrinsics/rgb": [f]}) for f in (1, 2))
    )
    one, two = (calibration_digest(episode, "rgb") for episode in dataset)
    assert one != two
    assert calibration_digest(dataset[0], "pose") == ""
