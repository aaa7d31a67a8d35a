"""What is shown of a grasp: five moments of it, the truth behind them, and a training window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from exumi_data.episode import Episode
from exumi_data.time import nearest_indices

if TYPE_CHECKING:
    from exumi_data.simulation import PlaySession

__all__ = [
    "GraspTruth",
    "Moment",
    "SheetWindow",
    "Span",
    "moments_of",
    "span_of",
    "truth_of",
    "window_of_episode",
]

TICK_NS = 50_050_000
"""Three frames of 59.94 fps, the loaders' default."""
FIRST_STEP, LAST_STEP = -15, 16
STEPS = (-12, -8, -4, 0, 4, 8, 12, 16)

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moment:
    """A named time of a grasp, nanoseconds since the episode's start."""

    name: str
    time_ns: int


@dataclass(frozen=True, slots=True)
class GraspTruth:
    """What really happened.

    Attributes
    ----------
    time_ns : (M,) int64
        Nanoseconds since the episode's start.
    width_m : (M,) float64
        Distance between the gels' surfaces, metres.
    height_m : (M,) float64
        Of the gripper above the table, metres.
    depth_m : dict of str to (M,) float64
        How deep the object was pressed into the gels, by tactile stream, metres.
    """

    time_ns: npt.NDArray[np.int64]
    width_m: Float64Array
    height_m: Float64Array
    depth_m: dict[str, Float64Array]


@dataclass(frozen=True, slots=True)
class SheetWindow:
    """A training window: tactile frames and a camera frame around step 0.

    Attributes
    ----------
    time_ns : int
        Time of step 0, nanoseconds since the episode's start.
    steps : sequence of int
        Steps of the tactile frames, ascending.
    tactile : (K, H, W, C) uint8
    rgb : (H, W, 3) uint8
    loader : str
        What it was made by.
    """

    time_ns: int
    steps: Sequence[int]
    tactile: npt.NDArray[np.uint8]
    rgb: npt.NDArray[np.uint8]
    loader: str


@dataclass(frozen=True, slots=True)
class Span:
    """Which part of a session an episode holds, seconds of the session.

    Attributes
    ----------
    start_s : float
        The episode's time 0.
    end_s : float
        Its last sample.
    """

    start_s: float
    end_s: float

    def time_ns(self, session_s: float) -> int:
        """Return a time of the session as one of the episode, inside it, nanoseconds."""
        return round((min(max(session_s, self.start_s), self.end_s) - self.start_s) * 1e9)


def span_of(episode: Episode, epoch_ns: int) -> Span:
    """Return which part of a session an episode holds.

    Parameters
    ----------
    episode : Episode
        All its streams have one clock.
    epoch_ns : int
        That clock's time at the session's start.
    """
    clock = episode["width"].metadata.clock
    start_ns = clock.t_ref_ns - clock.offset_ns - epoch_ns
    length_ns = max(int(stream.time[-1]) for stream in episode.streams.values())
    return Span(start_ns * 1e-9, (start_ns + length_ns) * 1e-9)


def moments_of(session: "PlaySession", grasp: int, span: Span) -> list[Moment]:
    """Choose five moments of a grasp from the truth.

    Parameters
    ----------
    session : PlaySession
    grasp : int
    span : Span
        Of the episode that holds the grasp.

    Returns
    -------
    list of Moment
        approach, touch, press, slide, release; in order of time.
    """
    known = session.grasps[grasp]
    held_s = np.linspace(known.t_contact_s, known.t_release_s, 400)
    depth = session.truth.contact_depth_m("left", held_s)
    press_s = held_s[int(np.argmax(depth > 0.99 * depth.max()))]
    touch_s = held_s[int(np.argmax(depth > 0.4 * depth.max()))]
    place = session.truth.contact_pose("left", held_s)
    start = place[int(np.searchsorted(held_s, press_s))]
    # A turn of 0.1 rad moves the pad's edge about as far as a shift of 1 mm.
    moved = np.hypot(*(place - start)[:, :2].T) * 1e3 + np.abs(place - start)[:, 2] * 10
    moved[held_s < press_s] = 0.0
    moved = np.nan_to_num(moved)
    times_s = {
        "approach": known.t_contact_s - 0.75,
        "touch": touch_s,
        "press": press_s,
        "slide": held_s[int(np.argmax(moved))],
        "release": known.t_release_s + 0.12,
    }
    return [Moment(name, span.time_ns(time_s)) for name, time_s in times_s.items()]


def truth_of(session: "PlaySession", span: Span) -> GraspTruth:
    """Return what happened while an episode was recorded, at 200 Hz.

    Parameters
    ----------
    session : PlaySession
    span : Span
    """
    time_s = np.arange(span.start_s, span.end_s, 0.005)
    return GraspTruth(
        time_ns=np.round((time_s - span.start_s) * 1e9).astype(np.int64),
        width_m=session.truth.width_m(time_s),
        height_m=session.truth.pose(time_s)[:, 2],
        depth_m={
            "tactile_left": session.truth.contact_depth_m("left", time_s),
            "tactile_right": session.truth.contact_depth_m("right", time_s),
        },
    )


def window_of_episode(episode: Episode, time_ns: int, stream: str) -> SheetWindow:
    """Make a window from an episode directly, for installations without PyTorch.

    Parameters
    ----------
    episode : Episode
    time_ns : int
        Time of step 0.
    stream : str
        The tactile stream.

    Returns
    -------
    SheetWindow
        With the steps that the loader takes when it does not draw them at random.
    """
    wanted = time_ns + np.array(STEPS) * TICK_NS
    chosen = nearest_indices(episode[stream].time, wanted, 10**18)
    camera = nearest_indices(episode["rgb"].time, np.array([time_ns]), 10**18)
    return SheetWindow(
        time_ns,
        STEPS,
        episode[stream].frames[chosen],
        episode["rgb"].frames[int(camera[0])],
        "nearest frames",
    )
