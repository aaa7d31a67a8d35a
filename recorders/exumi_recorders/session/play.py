"""Recording a simulated play session by itself: the simulated hand presses the button."""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from exumi_recorders.journal.states import RECORDING_FOLDER
from exumi_recorders.rig.simulated import SimulatedSettings, simulated_rig
from exumi_recorders.session.messages import Message, SessionReport, SessionStatus
from exumi_recorders.session.operator import Operator
from exumi_recorders.session.plan import Plan
from exumi_recorders.session.running import session_with
from exumi_recorders.session.session import Session
from exumi_recorders.simulated.play import SimulatedPlay

if TYPE_CHECKING:
    from exumi_data.simulation import Grasp, PlaySession

__all__ = ["RecordedPlay", "record_play"]

_AFTER_START_S = 0.25
"""The button is pressed so long after a reach begins: the last episode is closed by then."""
_PATIENCE_S = 5.0


@dataclass(frozen=True)
class RecordedPlay:
    """A play session that was recorded.

    Attributes
    ----------
    session : PlaySession
        The truth.
    epoch_ns : int
        CLOCK_MONOTONIC at the session's start: a stream's stamps, less this, are the truth's times.
    report : SessionReport
    """

    session: "PlaySession"
    epoch_ns: int
    report: SessionReport


def record_play(
    dataset: Path, settings: SimulatedSettings, plan: Plan, *, quiet: bool = False
) -> RecordedPlay:
    """Record a play session in real time, one episode a grasp.

    Parameters
    ----------
    dataset : pathlib.Path
        Made if it is not there.
    settings : SimulatedSettings
        When the button is pressed is worked out here.
    plan : Plan
    quiet : bool
        Say nothing but warnings.

    Raises
    ------
    ExumiError
        A device did not start, or the dataset cannot be used.
    """
    play = SimulatedPlay(
        seed=settings.seed, duration_s=settings.seconds, taps=settings.taps, epoch_ns=0
    )
    grasps = play.session().grasps
    settings = replace(settings, toggles_s=_toggles_s(grasps))
    with (
        _Unattended(len(grasps), quiet=quiet) as operator,
        simulated_rig(settings) as started,
    ):
        operator.end_ns = started.epoch_ns + round((settings.seconds + _PATIENCE_S) * 1e9)
        with session_with(started.rig, started.calibrated, dataset, plan, operator) as session:
            report = session.run()
    if not report.left and not report.problems:
        shutil.rmtree(dataset / RECORDING_FOLDER, ignore_errors=True)
    return RecordedPlay(started.session, started.epoch_ns, report)


def _toggles_s(grasps: "Sequence[Grasp]") -> tuple[float, ...]:
    return tuple(
        time_s for grasp in grasps for time_s in (grasp.t_start_s + _AFTER_START_S, grasp.t_end_s)
    )


class _Unattended(Operator):
    """Ends the session when everything is recorded, or should have been."""

    def __init__(self, episodes: int, *, quiet: bool) -> None:
        super().__init__(quiet=quiet, keys=False)
        self.end_ns = 0
        self._to_come = episodes
        self._session: Session | None = None

    def attend(self, session: Session, *, sync_age_s: float | None, preview: str | None) -> None:
        self._session = session
        super().attend(session, sync_age_s=sync_age_s, preview=preview)

    def tell(self, message: Message) -> None:
        super().tell(message)
        if message.code == "stopped":
            self._to_come -= 1
            if self._to_come == 0:
                self._quit()

    def show(self, status: SessionStatus) -> None:
        super().show(status)
        if time.monotonic_ns() > self.end_ns:
            self._quit()

    def _quit(self) -> None:
        if self._session is not None:
            self._session.command("quit")
