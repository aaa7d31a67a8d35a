"""The demonstration's picture: which grasp is shown, and what is written on it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from exumi_data.dataset import Dataset
from exumi_data.demo.canvas import Canvas
from exumi_data.demo.sheet import SheetText, contact_sheet
from exumi_data.demo.story import (
    GraspTruth,
    Moment,
    SheetWindow,
    Span,
    moments_of,
    span_of,
    truth_of,
)
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UsageError

if TYPE_CHECKING:
    from exumi_data.simulation import PlaySession

__all__ = ["ShownGrasp", "draw_grasp", "shown_grasp"]

_AFTER_TOUCH_NS = 300_000_000  # the window then begins before the touch and ends in the grasp


@dataclass(frozen=True, slots=True)
class ShownGrasp:
    """The grasp that the picture shows.

    Attributes
    ----------
    episode_id, object_name : str
    span : Span
        The part of the session that the episode holds.
    moments : list of Moment
        The columns of the picture.
    truth : GraspTruth
    window_ns : int
        Time of step 0 of the training window, nanoseconds since the episode's start.
    """

    episode_id: str
    object_name: str
    span: Span
    moments: list[Moment]
    truth: GraspTruth
    window_ns: int


def shown_grasp(session: "PlaySession", dataset: Dataset, epoch_ns: int) -> ShownGrasp:
    """Return the session's first grasp that an episode holds from touch to release.

    Parameters
    ----------
    session : PlaySession
    dataset : Dataset
    epoch_ns : int
        The episodes' clock at the session's start.

    Raises
    ------
    UsageError
        There is none.
    """
    spans = {}
    for name in dataset.ids:
        with dataset[name] as episode:
            spans[name] = span_of(episode, epoch_ns)
    for number, grasp in enumerate(session.grasps):
        for name, span in spans.items():
            if span.start_s < grasp.t_contact_s and grasp.t_release_s < span.end_s:
                return _shown(session, number, name, span)
    raise UsageError("no grasp was recorded as a whole", where=dataset.path, fix="Try again.")


def _shown(session: "PlaySession", number: int, name: str, span: Span) -> ShownGrasp:
    moments = moments_of(session, number, span)
    touch = next(moment for moment in moments if moment.name == "touch")
    return ShownGrasp(
        episode_id=name,
        object_name=session.grasps[number].object_name,
        span=span,
        moments=moments,
        truth=truth_of(session, span),
        window_ns=touch.time_ns + _AFTER_TOUCH_NS,
    )


def draw_grasp(
    episode: Episode, prepared: Episode, shown: ShownGrasp, window: SheetWindow, command: str
) -> Canvas:
    """Draw the picture.

    Parameters
    ----------
    episode : Episode
        The episode of `shown`.
    prepared : Episode
        The same, prepared for training: its activity is drawn.
    shown : ShownGrasp
    window : SheetWindow
    command : str
        What made it.

    Returns
    -------
    Canvas
    """
    text = SheetText(
        title="One grasp, felt by two fingertips",
        subtitle=f"exUMI Data  ·  {_how(episode)}, with known truth  ·  the object: "
        f"{shown.object_name}",
        foot=f"Camera and touch {_rate(episode['rgb'])} Hz, pose {_rate(episode['pose'])} Hz, "
        f"width {_rate(episode['width'])} Hz: every stream at its own rate, its latency known and "
        f"taken out.  Made by: {command}",
    )
    return contact_sheet(episode, prepared, shown.moments, shown.truth, window, text)


def _how(episode: Episode) -> str:
    is_recorded = episode["width"].metadata.clock.source == "hub_monotonic"
    return "recorded live from simulated devices" if is_recorded else "a simulated play session"


def _rate(stream: StreamView) -> int:
    return round(1e9 / float(np.median(np.diff(stream.time))))
