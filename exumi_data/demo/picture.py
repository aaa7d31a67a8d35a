"""The demonstration's picture: which grasp is shown, and what is written on it."""

from dataclasses import dataclass

from exumi_data.demo.canvas import Canvas
from exumi_data.demo.dataset import DemoSettings, episode_id, make_session
from exumi_data.demo.sheet import SheetText, contact_sheet
from exumi_data.demo.story import GraspTruth, Moment, SheetWindow, moments_of, truth_of
from exumi_data.episode import Episode

__all__ = ["ShownGrasp", "draw_grasp", "shown_grasp"]

_GRASP = 0
_AFTER_TOUCH_NS = 300_000_000  # the window then begins before the touch and ends in the grasp


@dataclass(frozen=True, slots=True)
class ShownGrasp:
    """The grasp that the picture shows.

    Attributes
    ----------
    episode_id, object_name : str
    moments : list of Moment
        The columns of the picture.
    truth : GraspTruth
    window_ns : int
        Time of step 0 of the training window, nanoseconds since the episode's start.
    """

    episode_id: str
    object_name: str
    moments: list[Moment]
    truth: GraspTruth
    window_ns: int


def shown_grasp(settings: DemoSettings) -> ShownGrasp:
    """Return the session's first grasp.

    Parameters
    ----------
    settings : DemoSettings
        As the dataset was made with.
    """
    session = make_session(settings.seed, settings.seconds)
    moments = moments_of(session, _GRASP)
    touch = next(moment for moment in moments if moment.name == "touch")
    return ShownGrasp(
        episode_id=episode_id(settings, _GRASP),
        object_name=session.grasps[_GRASP].object_name,
        moments=moments,
        truth=truth_of(session, _GRASP),
        window_ns=touch.time_ns + _AFTER_TOUCH_NS,
    )


def draw_grasp(
    episode: Episode, settings: DemoSettings, shown: ShownGrasp, window: SheetWindow
) -> Canvas:
    """Draw the picture.

    Parameters
    ----------
    episode : Episode
        The episode of `shown`.
    settings : DemoSettings
    shown : ShownGrasp
    window : SheetWindow

    Returns
    -------
    Canvas
    """
    text = SheetText(
        title="One grasp, felt by two fingertips",
        subtitle=f"exUMI Data  ·  a simulated play session with known truth  ·  the object: "
        f"{shown.object_name}",
        foot="Camera and touch 30 Hz, pose 90 Hz, width 200 Hz: every stream at its own rate, "
        "its latency known and taken out.  "
        f"Made by: exumi demo --seed {settings.seed} --seconds {settings.seconds:g}",
    )
    return contact_sheet(episode, shown.moments, shown.truth, window, text)
