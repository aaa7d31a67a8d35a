"""The steps of a window around its tick: how far it reaches, and where its frames lie."""

from dataclasses import dataclass

import numpy as np

from exumi_data.errors import UsageError

__all__ = ["WindowSteps", "window_anchors"]


@dataclass(frozen=True)
class WindowSteps:
    """Steps of a window in ticks, step 0 in its middle. The defaults are those of exUMI's paper.

    Attributes
    ----------
    history : int
        Steps of the history, which ends with step 0: −15..0 for 16.
    future : int
        Steps of the future: 1..16 for 16.
    history_frames : int
        Tactile frames of the history.
    future_frames : int
        Tactile frames of the future, at every ``future // future_frames``-th step.
    rgb : tuple of int
        Steps at which there is a frame of each camera.
    """

    history: int = 16
    future: int = 16
    history_frames: int = 4
    future_frames: int = 4
    rgb: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        """Check the values."""
        if not 1 <= self.history_frames <= self.history:
            raise UsageError(
                f"{self.history_frames} tactile frames of {self.history} steps of history"
            )
        if not 0 <= self.future_frames <= self.future:
            raise UsageError(
                f"{self.future_frames} tactile frames of {self.future} steps of future"
            )
        outside = [step for step in self.rgb if not self.first <= step <= self.last]
        if outside or not self.rgb:
            raise UsageError(
                f"rgb_steps are {self.rgb}, expected at least one in {self.first}..{self.last}"
            )

    @property
    def first(self) -> int:
        """The first step."""
        return 1 - self.history

    @property
    def last(self) -> int:
        """The last step."""
        return self.future

    @property
    def zero(self) -> int:
        """Position of step 0 among `all`."""
        return self.history - 1

    @property
    def all(self) -> np.ndarray:
        """(S,) int64: every step."""
        return np.arange(self.first, self.last + 1)

    @property
    def past(self) -> np.ndarray:
        """(H,) int64: the steps of the history, 0 the last."""
        return np.arange(self.first, 1)

    @property
    def fixed_history(self) -> np.ndarray:
        """Steps of the tactile history where it is not drawn: evenly spaced, 0 the last."""
        spacing = self.history // self.history_frames
        return np.arange(1 - self.history_frames, 1) * spacing

    @property
    def tactile_future(self) -> np.ndarray:
        """Steps of the future's tactile frames."""
        spacing = self.future // max(self.future_frames, 1)
        return np.arange(1, self.future_frames + 1) * spacing


def window_anchors(
    edges: np.ndarray, mode: str, stride: int, span: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Choose where windows lie.

    Parameters
    ----------
    edges : (E+1,) int64
        Ticks of episode e are ``edges[e]:edges[e+1]``.
    mode : {"pad", "drop"}
        Every tick, or only those whose window lies within the episode (one that is too short for
        any gives a window at its middle).
    stride : int
        Distance of windows in ticks.
    span : (int, int)
        First and last step of a window.

    Returns
    -------
    anchor : (W,) int64
        Flat tick of each window's step 0.
    episode : (W,) int64
        Its episode.
    """
    anchors = []
    owners = []
    for episode in range(len(edges) - 1):
        first, end = int(edges[episode]), int(edges[episode + 1])
        if first == end:
            continue
        if mode == "pad":
            found = np.arange(first, end, stride)
        else:
            found = np.arange(first - span[0], end - span[1], stride)
            if not len(found):
                found = np.array([(first + end - 1) // 2])
        anchors.append(found)
        owners.append(np.full(len(found), episode))
    if not anchors:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    return np.concatenate(anchors).astype(np.int64), np.concatenate(owners).astype(np.int64)
