"""How far what was stored is from what really happened."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from exumi_data.demo.story import Span
from exumi_data.episode import Episode

if TYPE_CHECKING:
    from exumi_data.simulation import PlaySession

__all__ = ["Deviation", "deviation_of"]


@dataclass(frozen=True, slots=True)
class Deviation:
    """Root mean square distances from the truth, at the stored times.

    Attributes
    ----------
    width_m : float
        Of the gripper's width, metres.
    place_m : float
        Of the gripper's place, metres.
    """

    width_m: float
    place_m: float


def deviation_of(session: "PlaySession", episode: Episode, span: Span) -> Deviation:
    """Compare an episode with the truth.

    Parameters
    ----------
    session : PlaySession
    episode : Episode
    span : Span
        Of the episode.
    """
    width, pose = episode["width"], episode["pose"]
    true_m = session.truth.width_m(span.start_s + width.time * 1e-9)
    true_place = session.truth.pose(span.start_s + pose.time * 1e-9)[:, :3]
    apart = np.linalg.norm(pose.data[:, :3] - true_place, axis=1)
    return Deviation(_rms(width.data - true_m), _rms(apart))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))
