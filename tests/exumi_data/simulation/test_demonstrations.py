"""Demonstrations one after the other, and the ways between them."""

import numpy as np

from exumi_data.simulation.demonstrations import simulate_demonstrations


def test_the_hand_can_be_asked_for_at_any_moment() -> None:
    """Just before a demonstration begins, the way to it is done but for rounding, and not more."""
    run = simulate_demonstrations(3, seed=0, seconds=4.0)
    for start, _ in run.spans_s:
        moments = start - np.geomspace(1e-12, 1e-3, 2000)
        poses = run.pose(moments)
        assert np.isfinite(poses).all()
        assert np.abs(poses - run.pose(np.array([start]))).max() < 1e-6
