"""What episodes say against what is true."""

import numpy as np
from numpy.typing import NDArray

from exumi_data.episode import Episode
from exumi_data.simulation.hub_session import HubSession
from exumi_data.simulation.hub_session.pictures import read_number

__all__ = ["numbers_of", "session_s", "true_frames_s"]


def session_s(episode: Episode, session: HubSession, time_ns: NDArray[np.int64]) -> np.ndarray:
    """Seconds of the session of an episode's times, as the episode has them."""
    start = np.datetime64(str(episode.metadata.start).removesuffix("Z"), "ns").astype(np.int64)
    return (time_ns + (int(start) - round(session.epoch_s * 1e9))) * 1e-9


def true_frames_s(episode: Episode, session: HubSession) -> np.ndarray:
    """When the camera's frames really were, seconds of the session."""
    clip = str(episode.metadata.source.key)
    count = len(episode["rgb"])
    return np.asarray(session.true_s(clip, np.arange(count) / float(session.settings.rgb_rate)))


def numbers_of(episode: Episode, stream: str) -> NDArray[np.int64]:
    """The numbers in the pictures of a stream."""
    return np.array([read_number(frame) for frame in episode[stream].frames], np.int64)
