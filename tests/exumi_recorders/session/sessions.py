"""A session that runs in a thread, with devices that send numbered samples."""

import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from exumi_recorders.contract import Driver
from exumi_recorders.journal.space import SpaceLimits
from exumi_recorders.recording.recorder import Recorder
from exumi_recorders.rig.model import About, Controls, Hooks, Rig
from exumi_recorders.rig.model import Limits as RigLimits
from exumi_recorders.session.labels import TrialCounter
from exumi_recorders.session.messages import CommandName, Message, SessionReport, SessionStatus
from exumi_recorders.session.plan import Calibrated, Plan
from exumi_recorders.session.session import Session
from tests.exumi_recorders.finalise.journals import make_dataset
from tests.exumi_recorders.numbered import device

ROOM = SpaceLimits(soft_bytes=0, hard_bytes=0, reserve_bytes=1 << 12)
PATIENCE_S = 20.0


def a_rig(**sections: Any) -> Rig:
    return Rig(
        path=None,
        about=About(name="toy", licence="CC0-1.0"),
        embodiment=None,
        controls=sections.get("controls", Controls()),
        limits=sections.get("limits", RigLimits(least_minutes=0)),
        hooks=sections.get("hooks", Hooks()),
        devices=(),
    )


class Running:
    """A session in a thread of its own; everything that it says is kept with its time."""

    def __init__(
        self,
        folder: Path,
        toys: Iterable[Driver],
        plan: Plan | None = None,
        *,
        calibrated: Calibrated | None = None,
        **sections: Any,
    ) -> None:
        self.dataset = make_dataset(folder / "set")
        self.recorder = Recorder(
            [device(toy, f"toy{number}") for number, toy in enumerate(toys)],
            space=ROOM,
        )
        self.said: list[tuple[float, Message]] = []
        self.status: SessionStatus | None = None
        self.report: SessionReport | None = None
        self._rig, self._plan = a_rig(**sections), plan or Plan(task="toy")
        self._calibrated = calibrated or Calibrated()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._read = 0

    def _hear(self, message: Message) -> None:
        self.said.append((time.monotonic(), message))

    def _see(self, status: SessionStatus) -> None:
        self.status = status

    def _run(self) -> None:
        self.report = self.session.run()

    def __enter__(self) -> Self:
        self.session = Session(
            self._rig,
            self.recorder,
            self.dataset,
            self._plan,
            self._calibrated,
            TrialCounter(),
            self._hear,
            self._see,
        )
        self.recorder.told = self.session.hear
        self.recorder.open()
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.quit()
        self.recorder.close()

    @property
    def codes(self) -> list[str]:
        return [message.code for _, message in self.said]

    def do(self, command: CommandName, reason: str = "", *, says: str) -> Message:
        """Give a command; return the next message of a code."""
        self.session.command(command, reason)
        return self.wait(says)

    def wait(self, code: str) -> Message:
        """Wait for the next message of a code, after those that were waited for before."""
        end = time.monotonic() + PATIENCE_S
        while True:
            for number in range(self._read, len(self.said)):
                if self.said[number][1].code == code:
                    self._read = number + 1
                    return self.said[number][1]
            assert time.monotonic() < end, (code, self.codes)
            time.sleep(0.01)

    def at(self, code: str) -> float:
        """When a code was said for the first time, CLOCK_MONOTONIC."""
        return next(time for time, message in self.said if message.code == code)

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, self.codes
            time.sleep(0.01)

    def quit(self) -> SessionReport:
        """End the session; return its report."""
        self.session.command("quit")
        return self.ended()

    def ended(self) -> SessionReport:
        """Wait for it to end by itself; return its report."""
        self._thread.join(60)
        assert self.report is not None
        return self.report
