"""The policy example runs as it stands, its task is what it says, and its episodes are valid."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from exumi_loaders import Normaliser
from exumi_validators import validate

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES))

from touch_policy import variants  # noqa: E402  # it lies there
from touch_policy.demonstrations import demonstrate, start  # noqa: E402
from touch_policy.encoders import (  # noqa: E402
    load_tpp,
    salient_images,
    train_byol,
    train_tpp,
    untrained_encoder,
)
from touch_policy.policy import DiffusionPolicy, train_policy  # noqa: E402
from touch_policy.rollouts import roll_out  # noqa: E402
from touch_policy.variants import Data, Sizes, make_data, open_windows, wilson  # noqa: E402
from touch_policy.world import TARGET_M, Ball, World, make_senses  # noqa: E402

SIZES = Sizes(demonstrations=2, play=2, encoder_steps=2, steps=40, attempts=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sorting")


@pytest.fixture(scope="module")
def data(folder: Path) -> Data:
    return make_data(folder, SIZES)


@pytest.fixture(scope="module")
def weights(data: Data, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the other example writes: two steps of training."""
    file = tmp_path_factory.mktemp("weights") / "weights.pt"
    options = ("--small", "--steps", "2", "--held-out", "2", "--save", file)
    done = start_example("train_tpp.py", str(data.play.path), *options)
    assert done.returncode == 0, done.stderr
    return file


def start_example(name: str, *options: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(EXAMPLES / name), *options],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env={**os.environ, "CUDA_VISIBLE_DEVICES": ""},  # its numbers are compared with a CPU's
    )


def run(folder: Path, *options: str | Path) -> subprocess.CompletedProcess[str]:
    small = ("--encoder-steps", "2", "--steps", "3", "--attempts", "2")
    return start_example("train_policy.py", folder, *small, *options)


def a_ball(give: float) -> Ball:
    return Ball(diameter_m=0.024, give=give, u_m=0.001, v_m=0.0, x_m=0.0)


def at_the_ball(ball: Ball, depth_m: float) -> World:
    world = World(ball, ball.width_m(depth_m))
    down = world.place - np.array([0, 0, 0.04])
    for _ in range(20):
        world.step(down, world.width_m)
    return world


@pytest.mark.parametrize("seed", range(8))
def test_who_knows_the_truth_succeeds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = start(rng)
    for place, width_m in demonstrate(world, rng):
        world.step(place, width_m)
    assert world.outcome().success
    assert world.depth_m == pytest.approx(TARGET_M, rel=0.1)


def test_hardness_is_felt_and_not_seen() -> None:
    senses = make_senses()
    hard, soft = (at_the_ball(a_ball(give), TARGET_M) for give in (0.1, 1.2))
    assert hard.depth_m == pytest.approx(soft.depth_m)
    imprints = [
        np.abs(senses.tactile(world).astype(float) - senses.pad.reference()).mean(-1) > 8
        for world in (hard, soft)
    ]
    assert imprints[1].any(axis=0).sum() > 1.3 * imprints[0].any(axis=0).sum()  # it is wider
    other = World(Ball(0.028, 1.2, 0.002, 0.001, 0.0), hard.width_m)
    same = World(a_ball(0.1), hard.width_m)
    np.testing.assert_array_equal(senses.rgb(other), senses.rgb(same))


def test_too_much_crushes_and_too_little_drops() -> None:
    ball = a_ball(0.1)
    assert at_the_ball(ball, 2.0 * TARGET_M).is_over
    world = at_the_ball(ball, 0.3 * TARGET_M)
    top = world.place + np.array([0, 0, 0.04])
    for _ in range(20):
        world.step(top, world.width_m)
    assert world.depth_m == 0
    assert not world.outcome().gripped


def test_the_episodes_are_valid(data: Data) -> None:
    for dataset in (data.demonstrations, data.play):
        assert dataset.path is not None
        report = validate(dataset.path, workers=1)
        assert [one for one in report.problems if one.severity != "info"] == []


def test_it_learns_and_runs_on_live_streams(data: Data) -> None:
    windows = open_windows(data.demonstrations)
    normaliser = Normaliser.fit(windows, any_split=True)
    policy = DiffusionPolicy(
        windows.policy_spec, normaliser, untrained_encoder(salient_images(data.play))
    )
    batch = windows.__getitems__(range(0, len(windows), 3))
    torch.manual_seed(0)
    before = policy.loss(batch).item()
    trained = train_policy(policy, windows, SIZES.steps, seed=0)
    assert policy.loss(batch).item() < 0.5 * before
    outcomes = [
        roll_out(trained, windows.policy_spec, data.demonstrations[0], 1, seed=0) for _ in range(2)
    ]
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("train", [train_byol, train_tpp])
def test_frozen_encoders_come_from_play(data: Data, train: Any) -> None:
    encoder = train(data.play, 2, 0)
    assert not any(weight.requires_grad for weight in encoder.parameters())
    features = encoder(salient_images(data.play))
    torch.testing.assert_close(features.mean(0), torch.zeros(encoder.size), atol=1e-4, rtol=0)
    again = train(data.play, 2, 0)(salient_images(data.play))
    torch.testing.assert_close(again, features)  # a function of the seed


def test_the_example_takes_an_encoder_of_train_tpp(folder: Path, weights: Path) -> None:
    done = run(folder, "--variant", "tpp", "--encoder", weights)
    assert done.returncode == 0, done.stderr
    assert "success" in done.stdout
    assert "of 2" in done.stdout


def test_the_encoder_of_train_tpp_is_the_one_that_is_trained(data: Data, weights: Path) -> None:
    images = salient_images(data.play)
    own, read = train_tpp(data.play, 2, 0), load_tpp(weights, data.play)
    assert not any(weight.requires_grad for weight in read.parameters())
    torch.testing.assert_close(read(images), own(images))
    other = train_tpp(data.play, 2, 1)
    assert (read(images) - other(images)).abs().max() > 0.1


def test_one_that_is_trained_is_used_in_the_same_way(data: Data, weights: Path) -> None:
    sizes = replace(SIZES, steps=2)
    assert variants.run("tpp", data, sizes, 0) == variants.run("tpp", data, sizes, 0, weights)


def test_episodes_that_were_not_all_written_are_written_anew(tmp_path: Path) -> None:
    sizes = Sizes(demonstrations=1, play=1)
    (tmp_path / "play.unfinished" / "episodes").mkdir(parents=True)
    made = make_data(tmp_path, sizes)
    assert (len(made.demonstrations), len(made.play)) == (1, 1)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["demonstrations", "play"]
    before = sorted(file.stat().st_mtime_ns for file in tmp_path.rglob("*"))
    make_data(tmp_path, sizes)
    assert sorted(file.stat().st_mtime_ns for file in tmp_path.rglob("*")) == before


def test_an_encoder_of_other_images_is_refused(data: Data, weights: Path, tmp_path: Path) -> None:
    trained = torch.load(weights, weights_only=True)
    two_fingers = {**trained, "vae.average": trained["vae.average"].repeat(2, 1, 1)}
    for wrong in (two_fingers, {"weight": torch.zeros(3)}):
        torch.save(wrong, tmp_path / "wrong.pt")
        with pytest.raises(ValueError, match=r"no encoder of images \(3, 32, 32\)"):
            load_tpp(tmp_path / "wrong.pt", data.play)


def test_intervals() -> None:
    low, high = wilson([True] * 8 + [False] * 2)
    assert (round(low, 3), round(high, 3)) == (0.490, 0.943)
    assert wilson([True] * 10)[1] == pytest.approx(1)
