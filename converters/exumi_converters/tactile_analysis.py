"""What is derived from a tactile stream while it is converted: reference, activity, salience.

Frames are seen once. Activity needs the reference, which is known only after the last frame; so
the grey frames of short clips are kept, and long ones are decoded a second time: memory is flat.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from exumi_data.errors import SourceError
from exumi_data.model import QualityNote
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import StreamWriter
from exumi_data.tactile import (
    ACTIVE_THRESHOLD,
    ACTIVITY_METHOD,
    REFERENCE_METHOD,
    SALIENCE_METHOD,
    ActivityMeter,
    ReferenceChoice,
    choose_reference,
    difference_energy,
    reference_image,
    salient_frames,
    thumbnail,
)

__all__ = [
    "REFERENCE_FROM",
    "SALIENT_FRAMES",
    "FrameReader",
    "TactileAnalysis",
    "add_activity",
    "add_salience",
    "estimated_note",
    "store_activity",
]

SALIENT_FRAMES = 10
"""How many salient frames are stored: as many as Octopi uses."""

_KEPT_BYTES = 64 << 20
REFERENCE_FROM = 8192
"""How many frames are searched for a reference.

Five minutes at 25 frames/s: the thumbnails of a longer clip would fill the memory, and a sensor
that is not at rest for as long will hardly be later.
"""


class FrameReader(Protocol):
    """Reads the frames of a stream again, for what the first pass could not know."""

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every frame in order, (H, W) uint8 luma."""
        ...

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Return some frames, ascending, each (H, W, C) uint8."""
        ...


class TactileAnalysis:
    """Collects what the first pass over a clip gives.

    Parameters
    ----------
    kept_bytes : int
        How much memory grey frames may fill.
    active_above : float
        Activity above which a frame counts as active.
    """

    def __init__(
        self, *, kept_bytes: int = _KEPT_BYTES, active_above: float = ACTIVE_THRESHOLD
    ) -> None:
        self.count = 0
        self._active_above = active_above
        self._left = kept_bytes
        self._kept: list[np.ndarray] | None = []
        self._thumbnails: list[np.ndarray] = []
        self._energies: list[int] = []
        self._previous: np.ndarray | None = None

    def add(self, grey: np.ndarray) -> None:
        """Take the next frame, (H, W) uint8. It must not change afterwards.

        Raises
        ------
        SourceError
            Its size is not that of the frames before.
        """
        if self._previous is not None and grey.shape != self._previous.shape:
            raise SourceError(
                f"frame {self.count} is {grey.shape[1]}x{grey.shape[0]}, the ones before are "
                f"{self._previous.shape[1]}x{self._previous.shape[0]}"
            )
        before = grey if self._previous is None else self._previous
        self._energies.append(difference_energy(before, grey))
        if self.count < REFERENCE_FROM:
            self._thumbnails.append(thumbnail(grey))
        self._keep(grey)
        self._previous = grey
        self.count += 1

    def _keep(self, grey: np.ndarray) -> None:
        if self._kept is None:
            return
        self._left -= grey.nbytes
        if self._left < 0:
            self._kept = None
        else:
            self._kept.append(grey)

    def finish(self, writer: EpisodeWriter, stream: StreamWriter, reader: FrameReader) -> None:
        """Store reference, activity and salient frames of a stream that is otherwise complete.

        Parameters
        ----------
        writer : EpisodeWriter
        stream : StreamWriter
            A tactile stream of `writer`.
        reader : FrameReader
            Gives the frames that were added, again.
        """
        choice = choose_reference(self._thumbnails)
        reference = reference_image(reader.pictures(choice.frames))
        stream.set_reference(
            reference,
            method=choice.method,
            frames=choice.frames,
            # An estimated reference may hold contact or not: that is not known.
            contact_free=True if choice.contact_free else None,
            algorithm=REFERENCE_METHOD,
        )
        if not choice.contact_free:
            writer.metadata.quality.append(estimated_note(stream.name, choice))
        greys: Callable[[], Iterable[np.ndarray]] = reader.greys
        kept = self._kept
        if kept is not None:
            greys = lambda: kept  # noqa: E731  # the other branch is a method
        add_activity(writer, stream.name, reference, greys(), active_above=self._active_above)
        add_salience(writer, stream.name, self._energies)


def estimated_note(stream: str, choice: ReferenceChoice) -> QualityNote:
    """Return the note that a reference may hold contact.

    Parameters
    ----------
    stream : str
    choice : ReferenceChoice
        Not free of contact.
    """
    return QualityNote(
        code="reference-estimated",
        message=f"no frames without contact were found ({choice.reason}): the reference image may "
        "hold contact, and activity may be too low",
        stream=stream,
        severity="info",
    )


def add_activity(
    writer: EpisodeWriter,
    stream: str,
    reference: np.ndarray,
    greys: Iterable[np.ndarray],
    *,
    active_above: float = ACTIVE_THRESHOLD,
) -> None:
    """Measure the activity of a stream's frames and store it.

    Parameters
    ----------
    writer : EpisodeWriter
    stream : str
    reference : (H, W, C) uint8
    greys : iterable of (H, W) uint8
    active_above : float
        Stored beside it: which frames count as active.
    """
    meter = ActivityMeter(reference)
    values = [meter.measure(grey) for grey in greys]
    store_activity(writer, stream, meter, values, active_above=active_above)


def store_activity(
    writer: EpisodeWriter,
    stream: str,
    meter: ActivityMeter,
    values: Sequence[float],
    *,
    active_above: float = ACTIVE_THRESHOLD,
) -> None:
    """Store the activity of a stream's frames.

    Parameters
    ----------
    writer : EpisodeWriter
    stream : str
    meter : ActivityMeter
        That measured it.
    values : sequence of float
    active_above : float
        Stored beside it: which frames count as active.
    """
    writer.add_derived(
        stream,
        "activity",
        np.array(values, dtype=np.float32),
        algorithm=ACTIVITY_METHOD,
        parameters={
            "threshold": meter.threshold,
            "size": meter.size,
            "active_above": active_above,
        },
        inputs=[f"streams/{stream}/data", f"streams/{stream}/reference"],
    )


def add_salience(writer: EpisodeWriter, stream: str, energies: Sequence[int]) -> None:
    """Select the salient frames of a stream and store their indices.

    Parameters
    ----------
    writer : EpisodeWriter
    stream : str
    energies : sequence of int
        Difference of each frame to the one before.
    """
    writer.add_derived(
        stream,
        "salient",
        salient_frames(np.asarray(energies, dtype=np.int64), SALIENT_FRAMES),
        algorithm=SALIENCE_METHOD,
        parameters={"k": SALIENT_FRAMES},
        inputs=[f"streams/{stream}/data"],
    )
