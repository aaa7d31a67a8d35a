"""Simulated episodes with known latency faults, for measuring how well they are found.

The frames are drawn and their activity is measured by `exumi_data.tactile`, as a recording's would
be; the width is what an encoder of limited resolution says.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exumi_data.simulation.encoder import WidthEncoder
from exumi_data.simulation.gel_look import make_pad
from exumi_data.simulation.objects import OBJECTS, Finger
from exumi_data.simulation.plan import plan_play
from exumi_data.simulation.renderers import make_tactile_renderer
from exumi_data.simulation.streams import sample_times_ns
from exumi_data.simulation.truth import GelStiffness, Truth
from exumi_data.tactile import ActivityMeter, to_grey

__all__ = ["Curve", "SyncEpisode", "make_episode"]

FRAME_PX = (120, 160)
_GRASP_S = 5.0
_FINGERS: tuple[Finger, Finger] = ("left", "right")


@dataclass(frozen=True)
class Curve:
    """Values over time, with the latency fault that its times have.

    Attributes
    ----------
    time_ns : (N,) int64
    values : (N,) float64
    fault_s : float
        By how much the times are late.
    """

    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    fault_s: float = 0.0


@dataclass(frozen=True)
class SyncEpisode:
    """An episode as a validator sees it, and what is true of it.

    Attributes
    ----------
    width : Curve
        Metres.
    activity : dict of {"left", "right"} to Curve
        By finger.
    grasps : int
        Whole grasps.
    soft : bool
        Whether the objects give way more than the gel.
    cut : {"", "before", "held"}
        Whether the recording ends before the last contact, or while the object is held.
    """

    width: Curve
    activity: dict[Finger, Curve]
    grasps: int
    soft: bool
    cut: str


@dataclass(frozen=True, slots=True)
class _SoftTruth(Truth):
    """A session whose objects give way too: the gel takes only a part of the indentation."""

    gel_part: float = 1.0

    def contact_depth_m(self, finger: Finger, t_s: ArrayLike) -> NDArray[np.float64]:
        return self.gel_part * Truth.contact_depth_m(self, finger, t_s)


def make_episode(seed: int) -> SyncEpisode:
    """Return a random episode; the same seed gives the same one.

    Parameters
    ----------
    seed : int
        Not negative.
    """
    rng = np.random.default_rng((seed, 77))
    grasps = int(rng.integers(1, 5))
    soft = bool(rng.random() < 0.4)
    chosen = tuple(OBJECTS[i] for i in rng.integers(0, len(OBJECTS), grasps))
    truth = _softened(plan_play(rng, grasps * _GRASP_S, chosen), rng, soft=soft)
    # A hurried hand and a slow one.
    pace = float(rng.uniform(0.6, 1.6))
    cut = str(rng.choice(["", "before", "held"], p=[0.8, 0.1, 0.1]))
    end_s = pace * _end_s(truth, cut)
    faults = _faults(rng)
    drop = float(rng.uniform(0.0, 0.05))
    jitter_s = float(rng.uniform(2e-4, 2e-3))
    activity = {
        finger: _activity(truth, finger, rng, pace, end_s, jitter_s, drop, fault)
        for finger, fault in zip(_FINGERS, faults, strict=True)
    }
    whole = grasps - (cut != "")
    return SyncEpisode(_width(truth, rng, pace, end_s), activity, whole, soft, cut)


def _softened(truth: Truth, rng: np.random.Generator, *, soft: bool) -> Truth:
    values = {field.name: getattr(truth, field.name) for field in fields(truth)}
    if not soft:
        gel = GelStiffness(give=float(rng.uniform(0.4, 0.7)))
        return Truth(**{**values, "gel": gel})
    gel = GelStiffness(float(rng.uniform(6e-3, 15e-3)), float(rng.uniform(0.7, 0.97)))
    return _SoftTruth(**{**values, "gel": gel}, gel_part=float(rng.uniform(0.25, 0.6)))


def _end_s(truth: Truth, cut: str) -> float:
    last = truth.grasps[-1]
    if cut == "before":
        return last.t_contact_s - 0.1
    return 0.5 * (last.t_contact_s + last.t_release_s) if cut == "held" else truth.duration_s


def _faults(rng: np.random.Generator) -> list[float]:
    """Return the faults of both fingers in seconds: none, 20 ms, or any."""
    faults = []
    for _ in _FINGERS:
        anything = float(rng.uniform(-0.12, 0.12))
        faults.append(float(rng.choice([0.0, -0.02, 0.02, anything], p=[0.5, 0.15, 0.15, 0.2])))
    return faults


def _activity(
    truth: Truth,
    finger: Finger,
    rng: np.random.Generator,
    pace: float,
    end_s: float,
    jitter_s: float,
    drop: float,
    fault_s: float,
) -> Curve:
    rate_hz = float(rng.choice([25.0, 30.0, 30.0, 60.0]))
    capture, _ = sample_times_ns(rng, end_s, rate_hz, jitter_s=jitter_s, drop=drop)
    pad = make_pad(FRAME_PX, dotted=False, seed=int(rng.integers(1 << 30)))
    shown_s = np.asarray(capture * 1e-9 / pace, np.float64)
    render = make_tactile_renderer(truth, finger, pad, shown_s, int(rng.integers(1 << 30)))
    meter = ActivityMeter(pad.reference())
    values = np.array([meter.measure(to_grey(render(i))) for i in range(len(capture))])
    return Curve(capture + round(fault_s * 1e9), values, fault_s)


def _width(truth: Truth, rng: np.random.Generator, pace: float, end_s: float) -> Curve:
    rate_hz = float(rng.choice([100.0, 200.0, 500.0]))
    capture, _ = sample_times_ns(rng, end_s, rate_hz, jitter_s=1e-4, drop=0.0)
    noise_m = rng.uniform(2e-5, 1e-4) * rng.standard_normal(len(capture))
    encoder = WidthEncoder()
    counts = encoder.counts(truth.width_m(capture * 1e-9 / pace) + noise_m)
    return Curve(capture, encoder.width_m(counts).astype(np.float64))
