"""A hub run of many demonstrations, simulated: what the hand does, and what the hub records.

Between two demonstrations the hand comes back and waits. The truth is known at every instant.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from exumi_data._version import __version__
from exumi_data.model import (
    CalibrationItem,
    Clock,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Gap,
    RawData,
    Sensor,
    Source,
    Task,
)
from exumi_data.simulation import OBJECTS, Truth, WidthEncoder
from exumi_data.simulation.motion import minimum_jerk
from exumi_data.simulation.plan import plan_play
from exumi_data.simulation.streams import sample_times_ns
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["Demonstrations", "simulate_demonstrations", "write_hub_session"]

Float64Array = NDArray[np.float64]

_POSE_HZ, _WIDTH_HZ, _TACTILE_HZ = 90.0, 100.0, 10.0
_POSE_NOISE_M, _POSE_NOISE_RAD, _POSE_JITTER_S = 1.5e-4, 8e-4, 1e-3
_POSE_LATENCY_NS = 12_000_000
_TACTILE_PX = 32
_MONOTONIC_NS = 4_512_000_000_123
_LOST = slice(400, 405)


@dataclass(frozen=True)
class Demonstrations:
    """What a hand does while a hub records.

    Attributes
    ----------
    spans_s : tuple of (float, float)
        When each demonstration begins and ends, seconds of the session.
    duration_s : float
    truths : tuple of Truth
        What happens in each, from its own second 0 on.
    """

    spans_s: tuple[tuple[float, float], ...]
    duration_s: float
    truths: tuple[Truth, ...]

    def pose(self, t_s: ArrayLike) -> Float64Array:
        """Return the hand's poses, (N, 7): x y z qx qy qz qw, metres.

        Parameters
        ----------
        t_s : array_like, shape (N,)
            Seconds of the session.
        """
        times = np.atleast_1d(np.asarray(t_s, np.float64))
        return self._joined(times, lambda truth, at: truth.pose(at), _between)

    def width_m(self, t_s: ArrayLike) -> Float64Array:
        """Return the gripper's opening, (N,) metres.

        Parameters
        ----------
        t_s : array_like, shape (N,)
            Seconds of the session.
        """
        times = np.atleast_1d(np.asarray(t_s, np.float64))
        return self._joined(
            times,
            lambda truth, at: truth.width_m(at),
            lambda before, after, share: before + share * (after - before),
        )

    def _joined(
        self,
        times: Float64Array,
        during: Callable[[Truth, Float64Array], Float64Array],
        pause: Callable[[Float64Array, Float64Array, Float64Array], Float64Array],
    ) -> Float64Array:
        """Evaluate demonstrations, and smooth ways from the end of each to the next one's start."""
        zero = np.zeros(1)
        stop, before = 0.0, during(self.truths[0], zero)[0]
        values = np.empty((len(times), *np.shape(before)))
        for (start, end), truth in zip(self.spans_s, self.truths, strict=True):
            waiting = (times >= stop) & (times < start)
            # Rounded, the polynomial may end a hair beyond 1.
            share = minimum_jerk((times[waiting] - stop) / (start - stop)).clip(0.0, 1.0)
            values[waiting] = pause(before, during(truth, zero)[0], share)
            inside = (times >= start) & (times < end)
            if inside.any():
                values[inside] = during(truth, times[inside] - start)
            stop, before = end, during(truth, np.array([end - start]))[0]
        values[times >= stop] = before
        values[times < 0.0] = during(self.truths[0], zero)[0]
        return values

    def rad_per_s(self, t_s: ArrayLike) -> Float64Array:
        """Return the hand's angular velocity about its own axes, (N, 3).

        Parameters
        ----------
        t_s : array_like, shape (N,)
            Seconds of the session.
        """
        times = np.atleast_1d(np.asarray(t_s, np.float64))
        half = 1e-3
        before = Rotation.from_quat(self.pose(times - half)[:, 3:])
        after = Rotation.from_quat(self.pose(times + half)[:, 3:])
        return np.asarray((before.inv() * after).as_rotvec() / (2 * half), np.float64)


def _between(before: Float64Array, after: Float64Array, share: Float64Array) -> Float64Array:
    places = before[:3] + share[:, None] * (after[:3] - before[:3])
    turns = Slerp([0.0, 1.0], Rotation.from_quat(np.stack([before[3:], after[3:]])))(share)
    return np.hstack([places, turns.as_quat()])


def simulate_demonstrations(
    count: int, *, seed: int = 0, seconds: float = 8.0, pause_s: float = 3.0
) -> Demonstrations:
    """Simulate a hub run.

    Parameters
    ----------
    count : int
        Demonstrations.
    seed : int, optional
    seconds, pause_s : float, optional
        About how long a demonstration and the pause after it are.
    """
    rng = np.random.default_rng([seed, count])
    at, spans, truths = pause_s, [], []
    for number in range(count):
        length = float(seconds * rng.uniform(0.85, 1.3))
        chosen = (OBJECTS[number % len(OBJECTS)],)
        truths.append(plan_play(np.random.default_rng([seed, number, 1]), length, chosen))
        spans.append((at, at + length))
        at += length + float(pause_s * rng.uniform(0.7, 1.6))
    return Demonstrations(tuple(spans), at, tuple(truths))


def write_hub_session(
    path: Path, demonstrations: Demonstrations, *, episode_id: str, start: str, seed: int = 0
) -> Path:
    """Write what the hub records: poses, widths and a tactile finger, and no camera.

    Parameters
    ----------
    path : pathlib.Path
        ``<something>.zarr``.
    demonstrations : Demonstrations
    episode_id : str
        UUIDv7.
    start : str
        UTC of the session's time 0.
    seed : int, optional
        Of noise and jitter.

    Returns
    -------
    pathlib.Path
    """
    encoder = WidthEncoder()
    metadata = EpisodeMetadata(
        id=episode_id,
        start=start,
        task=Task(name="simulated demonstrations"),
        regime="demonstration",
        calibration={
            "width_encoder": CalibrationItem(
                value={"zero_count": encoder.zero_count, "counts_per_m": encoder.counts_per_m},
                method="known: it is the simulator's own",
            )
        },
        licence="CC0-1.0",
        source=Source(type="recorded", tool="exumi record", tool_version=__version__),
    )
    with EpisodeWriter(path, metadata, durable=False) as writer:
        _write_pose(writer, demonstrations, np.random.default_rng([seed, 1]))
        _write_width(writer, demonstrations, encoder, np.random.default_rng([seed, 2]))
        _write_tactile(writer, demonstrations, np.random.default_rng([seed, 3]))
    return path


def _clock(latency_ns: int = 0) -> Clock:
    return Clock(
        source="hub_monotonic",
        stamp_point="simulated",
        t_ref_ns=_MONOTONIC_NS,
        raw_time="time_host",
        latency_ns=latency_ns,
    )


def _write_pose(
    writer: EpisodeWriter, demonstrations: Demonstrations, rng: np.random.Generator
) -> None:
    time, sequence = sample_times_ns(
        rng, demonstrations.duration_s, _POSE_HZ, jitter_s=_POSE_JITTER_S, drop=0.0
    )
    poses = demonstrations.pose(time * 1e-9)
    poses[:, :3] += rng.normal(0.0, _POSE_NOISE_M, (len(time), 3))
    noise = Rotation.from_rotvec(rng.normal(0.0, _POSE_NOISE_RAD, (len(time), 3)))
    poses[:, 3:] = (Rotation.from_quat(poses[:, 3:]) * noise).as_quat()
    flips = np.einsum("ij,ij->i", poses[1:, 3:], poses[:-1, 3:]) < 0
    poses[1:, 3:] *= np.where(np.logical_xor.accumulate(flips), -1.0, 1.0)[:, None]
    kept = np.ones(len(time), dtype=bool)
    kept[_LOST] = False
    stream = writer.add_stream(
        "pose",
        kind="pose",
        clock=_clock(latency_ns=_POSE_LATENCY_NS),
        frames=Frames(parent="world", child="tcp"),
        nominal_rate=f"{_POSE_HZ:.0f}",
        gaps=[Gap(after=_LOST.start - 1, lost=_LOST.stop - _LOST.start, reason="kernel")],
        sensor=Sensor(model="simulated-tracker"),
    )
    stream.append(
        time[kept],
        poses[kept],
        time_host=time[kept] + _POSE_LATENCY_NS + _MONOTONIC_NS,
        sequence=sequence[kept].astype(np.uint64),
        flags=np.zeros(np.count_nonzero(kept), np.uint32),
    )


def _write_width(
    writer: EpisodeWriter,
    demonstrations: Demonstrations,
    encoder: WidthEncoder,
    rng: np.random.Generator,
) -> None:
    time, _ = sample_times_ns(rng, demonstrations.duration_s, _WIDTH_HZ, jitter_s=1e-4, drop=0.0)
    raw = encoder.counts(demonstrations.width_m(time * 1e-9))
    stream = writer.add_stream(
        "width",
        kind="width",
        clock=_clock(),
        nominal_rate=f"{_WIDTH_HZ:.0f}",
        raw=RawData(unit="count", transform="width_encoder", modulus=1 << encoder.bits),
        sensor=Sensor(model="simulated-encoder"),
    )
    stream.append(time, encoder.width_m(raw), raw=raw, time_host=time + _MONOTONIC_NS)


def _write_tactile(
    writer: EpisodeWriter, demonstrations: Demonstrations, rng: np.random.Generator
) -> None:
    time, sequence = sample_times_ns(
        rng, demonstrations.duration_s, _TACTILE_HZ, jitter_s=4e-4, drop=0.0
    )
    quiet = np.full((_TACTILE_PX, _TACTILE_PX, 3), 128, np.uint8)
    stream = writer.add_stream(
        "tactile_left",
        kind="tactile",
        clock=_clock(),
        nominal_rate=f"{_TACTILE_HZ:.0f}",
        images=EncodedImages(
            encoding="encoded",
            media_type="image/jpeg",
            height=_TACTILE_PX,
            width=_TACTILE_PX,
            channels=3,
        ),
        sensor=Sensor(model="simulated-gel", side="left"),
    )
    files = [
        jpeg.encode((quiet + rng.integers(-6, 7, quiet.shape)).astype(np.uint8), 80) for _ in time
    ]
    stream.append(time, files, time_host=time + _MONOTONIC_NS, sequence=sequence.astype(np.uint64))
    stream.set_reference(quiet, method="captured", contact_free=True)
