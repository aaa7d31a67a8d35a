"""The small unrest of a hand that holds a gripper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from exumi_data.simulation.motion import Float64Array, Track

__all__ = ["Tremor", "make_tremor"]

# Slow sway and the 8 to 12 Hz of physiological tremor: (lowest Hz, highest Hz, metres, radians).
_BANDS = ((0.4, 1.0, 5e-4, 4e-3), (1.2, 2.5, 3e-4, 3e-3), (8.0, 11.0, 6e-5, 6e-4))


@dataclass(frozen=True, slots=True)
class Tremor:
    """A sum of sinusoids, faded out while the hand rests the gripper on an object.

    Attributes
    ----------
    frequency_hz : ndarray of float64, shape (B,)
        Frequencies.
    amplitude, phase : ndarray of float64, shape (B, 6)
        Amplitudes (metres for the first three columns, radians for the others) and phases (rad).
    envelope : Track
        Factor between 0 and 1, one component.
    """

    frequency_hz: Float64Array
    amplitude: Float64Array
    phase: Float64Array
    envelope: Track

    def __call__(self, t_s: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return the displacement (N, 3) in metres and the turn (N, 3) in radians."""
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        angle = 2 * np.pi * times[:, None, None] * self.frequency_hz[:, None] + self.phase
        shake = (self.amplitude * np.sin(angle)).sum(axis=1) * self.envelope(times)
        return shake[:, :3], shake[:, 3:]


def make_tremor(rng: np.random.Generator, envelope: Track) -> Tremor:
    """Return a random tremor with the given envelope."""
    frequency = np.array([rng.uniform(low, high) for low, high, _, _ in _BANDS])
    scale = np.array([[m, m, m, rad, rad, rad] for _, _, m, rad in _BANDS])
    amplitude = scale * rng.uniform(0.5, 1.0, scale.shape)
    return Tremor(frequency, amplitude, rng.uniform(0, 2 * np.pi, scale.shape), envelope)
