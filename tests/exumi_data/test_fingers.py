"""Fingers are told apart by the references of the rig's own."""

import numpy as np
import numpy.typing as npt
import pytest

from exumi_data.tactile import pattern_difference, resembled_finger

Image = npt.NDArray[np.uint8]


def gel(seed: int, level: float = 100.0) -> Image:
    spots = np.random.default_rng(seed).normal(0, 12, (20, 24))
    return np.clip(level + spots, 0, 255).astype(np.uint8)


def finger(image: Image, *, own: str = "left", right: Image | None = None) -> str | None:
    references = {"left": gel(1), "right": gel(2) if right is None else right}
    return resembled_finger(
        own, image, references, difference_ratio=0.7, references_grey_levels=2.0
    )


def test_a_finger_resembles_its_own_reference() -> None:
    assert finger(gel(1)) == "left"
    assert finger(gel(2)) == "right"
    assert finger(gel(2), own="right") == "right"


def test_the_light_does_not_matter() -> None:
    assert pattern_difference(gel(1, 130), gel(1, 100)) < 0.5
    assert finger(gel(2, 140)) == "right"


@pytest.mark.parametrize(("share", "found"), [(0.55, "left"), (0.65, "right")])
def test_another_one_has_to_be_clearly_nearer(share: float, found: str) -> None:
    # What is left of each pattern is in proportion: 0.45 / 0.55 = 0.8 is not clear, 0.54 is.
    blend = (1 - share) * gel(1).astype(float) + share * gel(2)
    assert finger(blend.round().astype(np.uint8)) == found


def test_references_that_look_alike_tell_nothing() -> None:
    almost = gel(1)
    almost[::4] += 4
    assert finger(gel(1), right=almost) is None
