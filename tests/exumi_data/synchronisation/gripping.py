"""Grasps and taps as curves: a drive that comes and goes, and a gel that takes a part of it."""

import numpy as np

NS = 1_000_000_000
CONTACT_M = 0.030


def drive_m(time_s: np.ndarray, speed: float = 1.0, period_s: float = 4.0) -> np.ndarray:
    """Where the fingers are driven to: down and up again in every period, smoothly."""
    phase = (time_s % period_s) / period_s
    way = np.clip((0.5 - np.abs(phase - 0.5)) * 4.0 * speed - 0.4, 0.0, 1.0)
    return 0.045 - 0.020 * way**2 * (3.0 - 2.0 * way)


def width_m(time_s: np.ndarray, give: float = 0.6, speed: float = 1.0) -> np.ndarray:
    """What an encoder sees: past the contact, only a part of the way is left."""
    drive = drive_m(time_s, speed)
    return np.where(drive < CONTACT_M, CONTACT_M - give * (CONTACT_M - drive), drive)


def activity(time_s: np.ndarray, give: float = 0.6, speed: float = 1.0) -> np.ndarray:
    """The share of active pixels: none at first, then growing ever less."""
    depth = CONTACT_M - width_m(time_s, give, speed)
    return np.asarray(0.3 * np.maximum(depth - 5e-5, 0.0) / (np.maximum(depth, 0.0) + 1.5e-3))


def frame_times(seconds: float, rate_hz: float = 30.0, seed: int = 0) -> np.ndarray:
    """Times in seconds with jitter, and one frame in thirty lost."""
    rng = np.random.default_rng(seed)
    times = (np.arange(int(seconds * rate_hz)) + rng.uniform(0.3, 0.7)) / rate_hz
    times += rng.normal(0.0, 3e-4, len(times))
    return times[rng.random(len(times)) > 1 / 30]


def as_ns(time_s: np.ndarray) -> np.ndarray:
    """Seconds as int64 nanoseconds."""
    return np.round(time_s * NS).astype(np.int64)


def counted(values: np.ndarray, seed: int = 0, step_m: float = 1.6e-4) -> np.ndarray:
    """What an encoder of limited resolution says, with its noise."""
    noise = 4e-5 * np.random.default_rng(seed).standard_normal(len(values))
    return np.asarray(np.round((values + noise) / step_m) * step_m)
