"""Running a policy: live samples into `PolicyStream`, its targets to the gripper."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

import exumi_data
from exumi_loaders import PolicySpec, PolicyStream
from exumi_loaders.targets import Targets
from touch_policy.demonstrations import start
from touch_policy.policy import DiffusionPolicy
from touch_policy.world import LATENCY_S, STEP_MS, Outcome, Sample, Senses, World, make_senses

__all__ = ["roll_out"]

_MS = 1_000_000
_LASTS_MS = 7000
_EVERY_MS = 200  # of which a new answer is asked for
_FIRST_MS = 100  # until each sensor has sent a sample
_FIRST_BALL = 1_000_000  # their seeds are none of the demonstrations'


@dataclass
class _Attempt:
    """A world, the samples that are on their way, and what the gripper follows."""

    world: World
    senses: Senses
    stream: PolicyStream
    targets: Targets | None = None
    coming: list[tuple[int, str, int, Sample]] = field(default_factory=list)

    def step(self) -> None:
        """Sense, let arrive what is due, and move."""
        now = self.world.time_ms
        for name, sample in self.senses.due(self.world).items():
            arrives = now + round(LATENCY_S[name] * 1e3)
            bisect.insort(self.coming, (arrives, name, now, sample), key=lambda one: one[0])
        while self.coming and self.coming[0][0] <= now:
            _, name, captured, sample = self.coming.pop(0)
            self.stream.push(name, captured * _MS, sample)
        self.world.step(*self._target(now + STEP_MS))

    def _target(self, at_ms: int) -> tuple[np.ndarray, float]:
        """Return where to be at a time: between two targets, or where it is until there are any."""
        if self.targets is None:
            return self.world.place, self.world.width_m
        times, pose = self.targets.time_ns, self.targets.pose["pose"]
        width = self.targets.width["width"]
        place = np.array([np.interp(at_ms * _MS, times, pose[:, i]) for i in range(3)])
        return place, float(np.interp(at_ms * _MS, times, width))


def roll_out(
    policy: DiffusionPolicy, spec: PolicySpec, rig: exumi_data.Episode, count: int, seed: int
) -> list[Outcome]:
    """Let a policy sort balls, in closed loop.

    The balls are a function of the seed: all policies are given the same ones. Attempts run side
    by side, so that the network answers all of them at once.

    Parameters
    ----------
    policy : DiffusionPolicy
    spec : PolicySpec
        Of the windows that it was trained on.
    rig : Episode
        One of the demonstrations: it describes the rig.
    count, seed : int
    """
    torch.manual_seed(seed)
    senses = make_senses()
    references = {name: senses.pad.reference() for name in spec.tactile}
    attempts = [
        _Attempt(
            start(np.random.default_rng([seed, _FIRST_BALL + number])),
            senses,
            PolicyStream(spec, rig, references=references, on_stale="raise"),
        )
        for number in range(count)
    ]
    going = attempts
    for now in range(0, _LASTS_MS, STEP_MS):
        if now >= _FIRST_MS and (now - _FIRST_MS) % _EVERY_MS == 0:
            _answer(policy, going, now * _MS)
        for attempt in going:
            attempt.step()
        going = [attempt for attempt in going if not attempt.world.is_over]
        if not going:
            break
    return [attempt.world.outcome() for attempt in attempts]


def _answer(policy: DiffusionPolicy, attempts: Sequence[_Attempt], now_ns: int) -> None:
    seen = [attempt.stream.observation(now_ns) for attempt in attempts]
    batch = {name: torch.stack([one[name] for one in seen]) for name in seen[0]}
    for attempt, action in zip(attempts, policy.act(batch), strict=True):
        attempt.targets = attempt.stream.absolute_targets(action, now_ns)
