"""The recording of one episode, while it is written."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from exumi_data.errors import ExumiError
from exumi_data.view.names import EVENTS
from exumi_data.view.panels import Panel
from exumi_data.view.report import Fault
from exumi_data.view.times import Timelines

__all__ = ["EVENTS_SHOWN", "Event", "Log"]

EVENTS_SHOWN = 200
"""Of one kind and stream: a broken stream may have one for each sample."""


@dataclass(frozen=True, slots=True)
class Event:
    """A line of the events.

    Attributes
    ----------
    time_ns : int
    text : str
    level : str
        Rerun's: ``INFO``, ``WARN`` or ``ERROR``.
    """

    time_ns: int
    text: str
    level: str


@dataclass(slots=True)
class Log:
    """Where the streams of one episode are logged to.

    Attributes
    ----------
    recording : rerun.RecordingStream
    timelines : Timelines
    on_samples : callable
        Told how many samples are done since the last time.
    panels : dict of Panel to int
        What was logged, in its order, and how often.
    samples : dict of str to int
    notes : list of str
    """

    recording: rr.RecordingStream
    timelines: Timelines
    on_samples: Callable[[int], None]
    panels: dict[Panel, int] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _faults: dict[str, list[ExumiError]] = field(default_factory=dict)
    _frames_missing: dict[str, int] = field(default_factory=dict)

    def fixed(self, path: str, thing: rr.AsComponents, *things: rr.AsComponents) -> None:
        """Log what holds for all times.

        Parameters
        ----------
        path : str
        thing, *things : rerun archetypes
        """
        self.recording.log(path, thing, *things, static=True, strict=True)

    def rows(self, path: str, time: np.ndarray, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log samples, and have them written: nothing of them stays in memory.

        Parameters
        ----------
        path : str
        time : (N,) int64
        columns : iterable of rerun.ComponentColumn
            Each with N rows.
        """
        if len(time):
            indexes = self.timelines.columns(time)
            self.recording.send_columns(path, indexes, columns, strict=True)
            self.recording.flush()

    def place(self, panel: Panel) -> None:
        """Give what was logged a place in the layout.

        Parameters
        ----------
        panel : Panel
            The same one for curves of one plot.
        """
        self.panels[panel] = self.panels.get(panel, 0) + 1

    def events(self, name: str, events: list[Event]) -> None:
        """Log events, the earliest first; of very many, the first ones.

        Parameters
        ----------
        name : str
            Whose they are: a stream's name, or ``episode``.
        events : list of Event
        """
        if not events:
            return
        ordered = sorted(events, key=lambda event: event.time_ns)
        shown = ordered[:EVENTS_SHOWN]
        if len(ordered) > len(shown):
            more = f"and {len(ordered) - len(shown):,} more events of this kind"
            shown.append(Event(shown[-1].time_ns, more, "INFO"))
        self.rows(
            f"{EVENTS}/{name}",
            np.array([event.time_ns for event in shown], np.int64),
            rr.TextLog.columns(
                text=[event.text for event in shown], level=[event.level for event in shown]
            ),
        )
        self.place(Panel("events", EVENTS, "Events"))

    def fault(self, stream: str, error: ExumiError, *, frame: bool = False) -> None:
        """Note that something of a stream cannot be read.

        Parameters
        ----------
        stream : str
        error : ExumiError
        frame : bool
            It is one frame.
        """
        errors = self._faults.setdefault(stream, [])
        if not errors:
            errors.append(error)
        self._frames_missing[stream] = self._frames_missing.get(stream, 0) + int(frame)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What could not be read, by stream."""
        return tuple(
            Fault(stream, self._frames_missing[stream], errors[0].reason)
            for stream, errors in self._faults.items()
        )
