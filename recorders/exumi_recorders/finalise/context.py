"""What all streams of a journal share while they are finalised."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from exumi_data.model.description import CalibrationItem, QualityNote
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_recorders.finalise.events import EventSummary
from exumi_recorders.finalise.poses import IDENTITY

__all__ = ["WORLD_FRAME", "Context", "WorldFrames"]

WORLD_FRAME = "world_frame"
"""The calibration item; its value is a pose as the headset sent it."""


@dataclass(frozen=True, slots=True)
class WorldFrames:
    """Where the world was marked in a headset's space, and from when on.

    Attributes
    ----------
    item : str
        The calibration item that holds the first one.
    since_ns : tuple of int
        Host times, ascending; the first one holds for what is before it, too.
    poses : tuple of (7,) float
    """

    item: str
    since_ns: tuple[int, ...]
    poses: tuple[tuple[float, ...], ...]


@dataclass(slots=True)
class Context:
    """The episode that is written, and what is known of all its streams.

    Attributes
    ----------
    writer : EpisodeWriter
    t0_ns : int
        CLOCK_MONOTONIC at the episode's start.
    events : EventSummary
    arrays : mapping of str to ndarray
        Of calibration items, by path below ``calibration/``.
    counts : dict of str to int
        Samples of each stream in the episode.
    worlds : dict of str to WorldFrames
        Of each device whose poses were transformed.
    """

    writer: EpisodeWriter
    t0_ns: int
    events: EventSummary
    arrays: Mapping[str, np.ndarray]
    counts: dict[str, int] = field(default_factory=dict)
    worlds: dict[str, WorldFrames] = field(default_factory=dict)

    @property
    def calibration(self) -> dict[str, CalibrationItem]:
        """Items of the episode."""
        return self.writer.metadata.calibration

    def note(
        self, code: str, message: str, stream: str | None = None, *, info: bool = False
    ) -> None:
        """Say something that a user of the episode should know.

        Parameters
        ----------
        code, message : str
        stream : str, optional
        info : bool
            It is no reason to worry.
        """
        self.writer.metadata.quality.append(
            QualityNote(
                code=code,
                message=message,
                severity="info" if info else "warning",
                **({} if stream is None else {"stream": stream}),
            )
        )

    def world_of(self, device: str, stream: str) -> WorldFrames:
        """Return where the world is in a device's space; it becomes a calibration item.

        Parameters
        ----------
        device, stream : str
        """
        known = self.worlds.get(device)
        if known is None:
            name = f"{WORLD_FRAME}/{device}" if self.worlds else WORLD_FRAME
            known = self.worlds[device] = self._find_world(device, stream, name)
        return known

    def _find_world(self, device: str, stream: str, name: str) -> WorldFrames:
        received = self.events.world_frames.get(device, [])
        # What was marked before the episode began holds from its start, but for the last of it.
        before = [each for each in received if each[0] <= self.t0_ns][-1:]
        frames = before + [each for each in received if each[0] > self.t0_ns]
        if frames:
            for number, (time_ns, pose) in enumerate(frames):
                since = (time_ns - self.t0_ns) / 1e9
                item = CalibrationItem(
                    value=list(pose), unit="m", method="marked by the operator, as it was sent"
                )
                if number:
                    item.procedure = f"holds from {since:.6f} s of the episode on"
                self.calibration[f"{name}/{number + 1}" if number else name] = item
            if len(frames) > 1:
                self.note(
                    "world-frame-moved",
                    f"the world was marked anew {len(frames) - 1} times; poses are in the world as "
                    "it was marked last before each, and as first marked before that",
                    stream,
                )
            return WorldFrames(
                name, tuple(each[0] for each in frames), tuple(each[1] for each in frames)
            )
        stated = self.calibration.get(name)
        if stated is not None and _is_pose(stated.value):
            return WorldFrames(name, (self.t0_ns,), (tuple(map(float, stated.value)),))
        self.calibration[name] = CalibrationItem(
            value=list(IDENTITY), unit="m", method="none was received: the headset's own space"
        )
        self.note(
            "world-frame-missing",
            "no world was marked: poses are in the headset's own space, made right-handed, Z up",
            stream,
        )
        return WorldFrames(name, (self.t0_ns,), (IDENTITY,))


def _is_pose(value: object) -> bool:
    if not isinstance(value, list) or len(value) != 7:
        return False
    numbers = all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    return numbers and bool(np.linalg.norm(np.array(value[3:], np.float64)) > 1e-6)
