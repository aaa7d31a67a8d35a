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

__all__ = ["GraspTruth", "Moment", "SheetWindow", "moments_of", "truth_of", "window_of_episode"]

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
    """What really happened: how deep the object was pressed into the gels.

    Attributes
    ----------
    time_ns : (M,) int64
        Nanoseconds since the episode's start.
    depth_m : dict of str to (M,) float64
        By tactile stream, metres.
    """

    time_ns: npt.NDArray[np.int64]
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


def moments_of(session: "PlaySession", grasp: int) -> list[Moment]:
    """Choose five moments of a grasp from the truth.

    Parameters
    ----------
    session : PlaySession
    grasp : int

    Returns
    -------
    list of Moment
        approach, touch, press, slide, release; in order of time.
    """
    known = session.grasps[grasp]
    held_s = np.linspace(known.t_contact_s, known.t_release_s, 400)
    depth = session.truth.contact_depth_m("left", held_s)
    press_s = held_s[int(np.argmax(depth > 0.99 * depth.max()))]
    touch_s = held_s[int(np.argmax(depth > 0.25 * depth.max()))]
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
    return [
        Moment(
            name, round((min(max(time_s, known.t_start_s), known.t_end_s) - known.t_start_s) * 1e9)
        )
        for name, time_s in times_s.items()
    ]


def truth_of(session: "PlaySession", grasp: int) -> GraspTruth:
    """Return the true contact depths of a grasp, at 200 Hz.

    Parameters
    ----------
    session : PlaySession
    grasp : int
    """
    known = session.grasps[grasp]
    time_s = np.arange(known.t_start_s, known.t_end_s, 0.005)
    return GraspTruth(
        np.round((time_s - known.t_start_s) * 1e9).astype(np.int64),
        {
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
