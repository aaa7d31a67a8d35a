"""A session: waits for the operator, records episodes one after the other, finishes them.

One thread runs `Session.run`. Commands come from anywhere: keys, the headset's flag, a timer.
An episode that was stopped waits until the next one begins, or for a few seconds: until then it
can be discarded, and what was discarded can be taken back.
"""

import queue
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from exumi_data.errors import ExumiError, UsageError
from exumi_data.model import Annotations
from exumi_data.model.calibration import RIG_REFERENCE
from exumi_recorders.contract import Event
from exumi_recorders.finalise.context import WORLD_FRAME
from exumi_recorders.finalise.events import SUCCESS
from exumi_recorders.finalise.touch import SESSION_REFERENCE
from exumi_recorders.journal.space import NoRoomError, SpaceLimits, seconds_left
from exumi_recorders.journal.states import discard, judge, undo_discard
from exumi_recorders.recording.recorder import Recorded, Recorder
from exumi_recorders.recording.status import RecordingStatus
from exumi_recorders.rig.model import Rig
from exumi_recorders.session.finishing import Finished, Finisher
from exumi_recorders.session.hooks import HookRunner
from exumi_recorders.session.labels import TrialCounter
from exumi_recorders.session.live_widths import LiveWidths
from exumi_recorders.session.messages import (
    Command,
    CommandName,
    Message,
    SessionReport,
    SessionStatus,
    State,
)
from exumi_recorders.session.plan import Calibrated, Plan, episode_document
from exumi_recorders.session.problems import ProblemTeller
from exumi_recorders.session.reference import ReferenceTaker

__all__ = ["Session"]

_PERIOD_S = 0.1
_STATUS_S = 0.25
_UNDO_S = 10.0
_ROOM_S = 2.0
_PATIENCE_S = 10.0


@dataclass(slots=True)
class _Stopped:
    recorded: Recorded
    said: Annotations | None
    until: float
    is_discarded: bool = False


class Session:
    """Record episodes with a rig. It is there before the devices open, to hear their events.

    Parameters
    ----------
    rig : Rig
    recorder : Recorder
        Open when `run` is called; its `told` should lead to `hear`.
    dataset : pathlib.Path
    plan : Plan
    calibrated : Calibrated
    trials : TrialCounter
        Of the dataset's episodes so far.
    tell : callable
        Told of each message, in the thread of `run`.
    show : callable
        Given the status about four times a second.
    """

    def __init__(  # what a session is put together from
        self,
        rig: Rig,
        recorder: Recorder,
        dataset: Path,
        plan: Plan,
        calibrated: Calibrated,
        trials: TrialCounter,
        tell: Callable[[Message], None],
        show: Callable[[SessionStatus], None],
    ) -> None:
        self._rig = rig
        self._recorder = recorder
        self._dataset = dataset
        self._plan = plan
        self._calibrated = calibrated
        self._trials = trials
        self._tell = tell
        self._show = show
        self._hooks = HookRunner(rig.hooks)
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._finished: queue.SimpleQueue[Finished] = queue.SimpleQueue()
        self._finisher = Finisher(self._finished.put)
        self._report = SessionReport()
        self._begun: list[Path] = []
        self._state: State = "waiting"
        self._began = 0.0
        self._said: Annotations | None = None
        self._stopped: _Stopped | None = None
        self._kept = 0
        self._next_auto: float | None = time.monotonic() if plan.auto else None
        self._problems = ProblemTeller(tell)
        self._hook_problems = 0
        self._room_s = float("inf")
        self._room_at = 0.0
        self._opened = time.monotonic()
        self._flag_device = rig.controls.flag
        self._world_device = rig.controls.world_frame
        self._has_world = False
        self._reference = ReferenceTaker((), recorder.latest_frame)
        self._widths = LiveWidths((), {})

    def command(self, name: CommandName, reason: str = "") -> None:
        """Want something; for any thread and for signal handlers.

        Parameters
        ----------
        name : str
        reason : str
        """
        self._commands.put(Command(name, reason))

    def hear(self, device: str, event: Event) -> None:
        """Take an event of a device: record flag and world frame of those that the rig file names.

        Parameters
        ----------
        device : str
        event : Event
        """
        if event.name == "record_flag" and device == self._flag_device:
            self.command("start" if event.detail.get("on") else "stop")
        elif event.name == "world_frame" and device == self._world_device:
            self._has_world = True

    @property
    def report(self) -> SessionReport:
        """What the session made so far; whole once `run` has ended, however it did."""
        return self._report

    # --------------------------------------------------------------------------------- the session

    def run(self) -> SessionReport:
        """Record until somebody quits, or all is recorded.

        Returns
        -------
        SessionReport

        Raises
        ------
        KeyboardInterrupt
            What is not finished is kept as journals.
        """
        self._opened = time.monotonic()
        self._hook("ready")
        self._widths = LiveWidths(self._recorder.streams.values(), self._calibrated.items)
        self._reference = ReferenceTaker(
            self._recorder.streams.values(), self._recorder.latest_frame
        )
        self._take_references(
            [
                name
                for name in self._reference.streams
                if f"{RIG_REFERENCE}{name}" not in self._calibrated.items
            ],
            nothing_touched=False,
        )
        shown = 0.0
        try:
            while self._state != "ended":
                self._obey()
                self._look()
                now = time.monotonic()
                if now - shown >= _STATUS_S:
                    shown = now
                    self._watch(self._recorder.status())
                time.sleep(_PERIOD_S)
        except KeyboardInterrupt:
            self._finisher.give_up()
            raise
        finally:
            try:
                self._end()
            finally:
                self._report.left = self._unfinished()
        return self._report

    def _unfinished(self) -> list[Path]:
        """Return the journals that are still to become episodes."""
        done = {one.journal for one in self._report.finished} | set(self._report.discarded)
        return [path for path in self._begun if path not in done and path.exists()]

    def _end(self) -> None:
        """Stop what is being recorded, and finish everything."""
        if self._recorder.status().episode is not None:
            self._stop("the session ended")
        self._settle()
        self._state = "ended"
        try:
            if self._finisher.waiting:
                self._tell(Message("info", "finishing", "finishing the last episodes ..."))
                self._show(self._status(self._recorder.status()))
            self._finisher.close()
        except BaseException:
            self._finisher.give_up()
            raise
        finally:
            self._collect()
            self._hooks.close()

    def _obey(self) -> None:
        while True:
            try:
                command = self._commands.get_nowait()
            except queue.Empty:
                return
            name = command.name
            if name == "toggle":
                name = "stop" if self._state == "recording" else "start"
            if name == "start" and self._state == "waiting":
                self._start()
            elif name == "stop" and self._state == "recording":
                self._stop("")
            elif name == "discard":
                self._discard(command.reason)
            elif name == "reason":
                self._give_reason(command.reason)
            elif name == "undo":
                self._undo()
            elif name in {"success", "failure"}:
                self._judge(success=name == "success")
            elif name == "reference":
                self._renew_references()
            elif name == "quit":
                self._state = "ended"

    def _look(self) -> None:
        """Do what has come due."""
        self._collect()
        now = time.monotonic()
        if self._stopped is not None and now >= self._stopped.until:
            self._settle()
        if self._state == "recording":
            longest_s = self._plan.duration_s or 60.0 * self._rig.limits.longest_minutes
            if now - self._began >= longest_s:
                why = "" if self._plan.duration_s else "it is as long as the rig file allows"
                self._stop(why)
        elif self._state == "waiting":
            self._collect_references()
            if self._plan.episodes is not None and self._kept >= self._plan.episodes:
                self._state = "ended"
            elif self._next_auto is not None and now >= self._next_auto and self._is_ready(now):
                self._start()

    def _is_ready(self, now: float) -> bool:
        """Whether all is there, or has had time enough: for episodes that begin by themselves."""
        if now >= self._opened + _PATIENCE_S:
            return True
        streams = self._recorder.status().streams
        return (
            self._lacks_world is None
            and not self._reference.is_busy
            and all(stream.rate_hz is not None for stream in streams)
        )

    @property
    def _lacks_world(self) -> str | None:
        if self._world_device is None or self._has_world or WORLD_FRAME in self._calibrated.items:
            return None
        return f"{self._world_device} has sent no world frame yet: mark the world first"

    # ---------------------------------------------------------------------------------- an episode

    def _start(self) -> None:
        self._settle()
        if self._plan.episodes is not None and self._kept >= self._plan.episodes:
            return
        trial = self._trials.next_trial(self._plan.labels)
        said = self._plan.labels.annotations(trial)
        document = episode_document(self._rig, self._plan, self._calibrated, said)
        try:
            if self._lacks_world is not None:
                raise UsageError(self._lacks_world)
            self._check_room()
            self._begun.append(
                self._recorder.start(self._dataset, document, arrays=self._calibrated.arrays)
            )
        except (ExumiError, OSError, ValueError) as error:  # what the calibration says, at worst
            text = f"not recording: {error}"
            self._tell(Message("error", "not_started", text))
            self._hook("problem")
            if self._plan.auto:
                # Nobody may be there to mend it and to begin again.
                self._report.not_started, self._state = text, "ended"
            return
        self._state, self._began, self._said = "recording", time.monotonic(), said
        self._hook("start")
        trial_text = f", trial {trial}" if said is not None and said.trial else ""
        number = self._kept + 1
        self._tell(
            Message("info", "recording", f"recording episode {number}{trial_text}", document.id)
        )

    def _check_room(self) -> None:
        least_s = 60.0 * self._rig.limits.least_minutes
        room_s = self._room_left()
        if room_s < least_s:
            raise NoRoomError(
                f"there is room for {room_s / 60:.1f} minutes only",
                where=self._dataset,
                fix="Copy recordings away and remove them here, or record to another disk.",
            )

    def _room_left(self) -> float:
        now = time.monotonic()
        if now - self._room_at > _ROOM_S:
            ports = [stream.port for stream in self._recorder.streams.values()]
            limits = SpaceLimits(reserve_bytes=self._rig.limits.reserve_mb << 20)
            self._room_s, self._room_at = seconds_left(self._dataset, ports, limits), now
        return self._room_s

    def _stop(self, why: str) -> None:
        recorded = self._recorder.stop()
        self._state = "waiting"
        # Episodes that begin by themselves do not wait for the operator's second thoughts.
        undo_s = min(self._plan.pause_s, _UNDO_S) if self._plan.auto else _UNDO_S
        self._stopped = _Stopped(recorded, self._said, time.monotonic() + undo_s)
        if self._plan.auto:
            self._next_auto = time.monotonic() + self._plan.pause_s
        self._hook("stop")
        samples = sum(recorded.samples.values())
        why = recorded.truncated or why
        text = f"stopped after {time.monotonic() - self._began:.1f} s, {samples:,} samples"
        level: Literal["info", "warning"] = "warning" if recorded.truncated else "info"
        self._tell(
            Message(level, "stopped", f"{text}: {why}" if why else text, recorded.journal.stem)
        )
        dropped = {name: number for name, number in recorded.dropped.items() if number}
        if dropped:
            said = ", ".join(f"{number} of {name}" for name, number in dropped.items())
            self._tell(Message("warning", "dropped", f"the disk was too slow: lost {said}"))

    def _settle(self) -> None:
        """Finish the episode that could still have been discarded."""
        stopped, self._stopped = self._stopped, None
        if stopped is None or stopped.is_discarded:
            return
        self._kept += 1
        self._trials.add(stopped.said)
        self._finisher.put(stopped.recorded.journal)

    def _discard(self, reason: str) -> None:
        if self._state == "recording":
            self._stop("to be discarded")
        stopped = self._stopped
        if stopped is None or stopped.is_discarded:
            self._tell(Message("warning", "nothing", "there is nothing to discard any more"))
            return
        journal = stopped.recorded.journal
        try:
            discard(journal, reason or "no reason given")
        except ExumiError as error:
            self._tell(Message("error", "not_discarded", str(error)))
            return
        stopped.is_discarded, stopped.until = True, time.monotonic() + _UNDO_S
        self._report.discarded.append(journal)
        self._hook("discard")
        text = f"discarded ({reason})" if reason else f"discarded; {self._reasons()}"
        self._tell(Message("info", "discarded", f"{text}; undo takes it back", journal.stem))

    def _reasons(self) -> str:
        named = enumerate(self._rig.controls.reasons, start=1)
        return "why: " + ", ".join(f"{number} {text}" for number, text in named)

    def _give_reason(self, said: str) -> None:
        """Say why the last episode was discarded: in words, or by the number of a known reason."""
        stopped, reasons = self._stopped, self._rig.controls.reasons
        if said.isdecimal():
            said = reasons[int(said) - 1] if 0 < int(said) <= len(reasons) else ""
        if stopped is None or not stopped.is_discarded or not said:
            text = "there is nothing to give that reason for: discard first"
            self._tell(Message("warning", "nothing", text))
            return
        try:
            discard(stopped.recorded.journal, said)
        except ExumiError as error:
            self._tell(Message("error", "not_discarded", str(error)))
            return
        self._tell(Message("info", "reason", f"because: {said}", stopped.recorded.journal.stem))

    def _undo(self) -> None:
        stopped = self._stopped
        if stopped is None or not stopped.is_discarded:
            self._tell(Message("warning", "nothing", "there is nothing to take back"))
            return
        try:
            undo_discard(stopped.recorded.journal)
        except ExumiError as error:
            self._tell(Message("error", "not_undone", str(error)))
            return
        stopped.is_discarded = False
        self._report.discarded.remove(stopped.recorded.journal)
        self._tell(Message("info", "undone", "taken back", stopped.recorded.journal.stem))

    def _judge(self, *, success: bool) -> None:
        stopped = self._stopped
        if self._state == "recording":
            self._recorder.add_event(SUCCESS, value=success)
        elif stopped is not None and not stopped.is_discarded:
            try:
                judge(stopped.recorded.journal, success=success)
            except (ExumiError, OSError) as error:
                self._tell(Message("error", "not_judged", str(error)))
                return
        else:
            self._tell(Message("warning", "nothing", "there is no episode to judge any more"))
            return
        self._tell(Message("info", "judged", "a success" if success else "a failure"))

    # ------------------------------------------------------------------------------ tactile at rest

    def _take_references(self, streams: Sequence[str], *, nothing_touched: bool) -> None:
        if not streams:
            return
        self._reference.want(streams, nothing_touched=nothing_touched)
        text = f"taking the reference of {', '.join(streams)}: the fingers must not touch anything"
        self._tell(Message("info", "reference", text))

    def _renew_references(self) -> None:
        """Take references because the operator says that nothing is touched."""
        if self._state != "waiting":
            text = "a reference is taken between episodes only"
        elif not self._reference.streams:
            text = "there is no tactile camera"
        else:
            self._take_references(self._reference.streams, nothing_touched=True)
            return
        self._tell(Message("warning", "nothing", text))

    def _collect_references(self) -> None:
        for taken in self._reference.look():
            if taken.item is None or taken.image is None:
                text = f"no reference of {taken.stream}: {taken.problem}; r takes it again"
                self._tell(Message("warning", "no_reference", text))
                continue
            name = f"{SESSION_REFERENCE}{taken.stream}"
            self._calibrated = Calibrated(
                {**self._calibrated.items, name: taken.item},
                {**self._calibrated.arrays, name: taken.image},
            )
            text = f"reference of {taken.stream} taken; r takes it again, if it was touched"
            self._tell(Message("info", "reference_taken", text))

    # ----------------------------------------------------------------------------- what is watched

    def _watch(self, status: RecordingStatus) -> None:
        if self._state == "recording" and status.truncated is not None:
            self._stop("")
        for _ in range(self._problems.tell(status.problems)):
            self._hook("problem")
        self._show(self._status(status))

    def _status(self, recording: RecordingStatus) -> SessionStatus:
        labelled = self._plan.labels.annotations(1) is not None
        undecided = self._stopped is not None and not self._stopped.is_discarded
        trial = self._trials.next_trial(self._plan.labels) + undecided
        return SessionStatus(
            state=self._state,
            recording=recording,
            kept=self._kept,
            discarded=len(self._report.discarded),
            finishing=self._finisher.waiting,
            undecided=undecided,
            disk_minutes=self._room_left() / 60,
            next_trial=trial if labelled else None,
            widths_m=self._widths.of(recording),
        )

    def _hook(self, name: str) -> None:
        self._hooks.run(name)
        for text in self._hooks.problems[self._hook_problems :]:
            self._hook_problems += 1
            self._tell(Message("warning", "hook", text))

    def _collect(self) -> None:
        for done in _drained(self._finished):
            self._report.finished.append(done)
            if done.problem:
                text = f"{done.journal}: {done.problem}; exumi recover tries again"
                self._tell(Message("error", "not_finished", text, done.journal.stem))
            else:
                damage = f", {done.damages} damages" if done.damages else ""
                self._tell(
                    Message("info", "kept", f"kept: {done.episode}{damage}", str(done.episode))
                )


def _drained(finished: "queue.SimpleQueue[Finished]") -> Sequence[Finished]:
    found = []
    while True:
        try:
            found.append(finished.get_nowait())
        except queue.Empty:
            return found
