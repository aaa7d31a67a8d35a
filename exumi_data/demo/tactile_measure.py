"""What is derived from a tactile stream while it is written: activity and salient frames."""

import numpy as np
import numpy.typing as npt

from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import (
    ACTIVE_THRESHOLD,
    ACTIVITY_METHOD,
    SALIENCE_METHOD,
    ActivityMeter,
    difference_energy,
    salient_frames,
)

__all__ = ["TactileMeasure"]

_SALIENT = 10


class TactileMeasure:
    """Activity and frame differences of a tactile stream, from the frames as they are stored."""

    def __init__(self, reference: npt.NDArray[np.uint8]) -> None:
        self._meter = ActivityMeter(reference)
        self._shape = (*reference.shape[:2], 1)
        self._activity: list[float] = []
        self._energy: list[int] = []
        self._previous: npt.NDArray[np.uint8] | None = None

    def add(self, file: bytes) -> None:
        """Measure the next frame."""
        frame = np.empty(self._shape, np.uint8)
        jpeg.decode_into(file, frame)
        grey = frame[..., 0]
        previous = self._previous
        self._activity.append(self._meter.measure(grey))
        self._energy.append(0 if previous is None else difference_energy(previous, grey))
        self._previous = grey

    def write(self, writer: EpisodeWriter, name: str) -> None:
        """Add what was measured to the episode."""
        data = f"streams/{name}/data"
        writer.add_derived(
            name,
            "activity",
            np.array(self._activity, np.float32),
            algorithm=ACTIVITY_METHOD,
            parameters={
                "threshold": self._meter.threshold,
                "size": self._meter.size,
                "active_above": ACTIVE_THRESHOLD,
            },
            inputs=[data, f"streams/{name}/reference"],
        )
        writer.add_derived(
            name,
            "salient",
            salient_frames(self._energy, _SALIENT),
            algorithm=SALIENCE_METHOD,
            parameters={"k": _SALIENT},
            inputs=[data],
        )
