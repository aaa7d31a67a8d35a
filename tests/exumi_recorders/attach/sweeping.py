"""A session in which somebody swept a marker before some clips, and those clips."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration import add_intrinsics
from exumi_data.geometry import compose
from exumi_data.model import Clock, EpisodeMetadata, Frames, Source, Task
from exumi_data.simulation.demonstrations import simulate_demonstrations
from exumi_data.simulation.sweep import SimulatedSweep, SweepSettings
from exumi_data.simulation.sweep_recording import CAMERA, write_sweep_clip
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["SESSION_ID", "SweptSession", "sweep_settings", "write_swept_session"]

SESSION_ID = "01932c00-1f00-7000-8000-0000000000aa"
_LATENCY_NS = 25_000_000
_SECONDS = 7.0
_EDGE_S = 1.0
# Where the marker's own world is in the session's: nothing lies along the same axes.
_TABLE = np.array([0.7, -0.4, 0.9, 0.18257419, 0.36514837, 0.54772256, 0.73029674])


@dataclass(frozen=True)
class SweptSession:
    """What was written.

    Attributes
    ----------
    session, clips : pathlib.Path
    starts_s : dict of str to float
        When each clip of the session begins, seconds of it.
    foreign : str
        A clip of another session.
    """

    session: Path
    clips: Path
    starts_s: dict[str, float]
    foreign: str


def sweep_settings(**changes: float) -> SweepSettings:
    """Return how the hand is swept in these sessions."""
    fields = {
        "rate_hz": 0.9,
        "seconds": _SECONDS,
        "frames_per_s": 20.0,
        "missing": 0.0,
        "exposure_s": 0.004,
        "readout_s": 0.012,
        **changes,
    }
    return SweepSettings(**fields)  # type: ignore[arg-type]  # floats only


def write_swept_session(folder: Path) -> SweptSession:
    """Write ``session.zarr`` and a folder ``clips``: two of the session, one of another."""
    clips = folder / "clips"
    clips.mkdir(parents=True)
    starts = {"GX010001.MP4": 21.37, "GX010002.MP4": 61.0123}
    for seed, name in enumerate(starts):
        write_sweep_clip(clips / name, sweep_settings(), seed=seed)
    foreign = "GX010003.MP4"
    write_sweep_clip(clips / foreign, sweep_settings(), seed=9)
    time_s = np.arange(0.0, 90.0, 1 / 90.0)
    rng = np.random.default_rng(5)
    poses = _poses(time_s, list(starts.values()))
    poses[:, :3] += 3e-4 * rng.standard_normal((len(poses), 3))
    _write(folder / "session.zarr", np.rint(1e9 * time_s).astype(np.int64), poses)
    return SweptSession(folder / "session.zarr", clips, starts, foreign)


def _poses(time_s: NDArray[np.float64], starts_s: list[float]) -> NDArray[np.float64]:
    poses = simulate_demonstrations(8, seed=3).pose(time_s)
    for seed, start in enumerate(starts_s):
        inside = (time_s >= start - _EDGE_S) & (time_s < start + _SECONDS + _EDGE_S)
        swept = SimulatedSweep(sweep_settings(), seed).poses(time_s[inside] - start)
        poses[inside] = compose(np.tile(_TABLE, (len(swept), 1)), swept)
    return poses


def _write(path: Path, time_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> None:
    metadata = EpisodeMetadata(
        id=SESSION_ID,
        start="2026-03-01T12:00:00Z",
        task=Task(name="simulated"),
        regime="demonstration",
        licence="CC0-1.0",
        source=Source(type="recorded", tool="exumi record", tool_version="0"),
    )
    clock = Clock(
        source="hub_monotonic",
        stamp_point="simulated",
        t_ref_ns=0,
        raw_time="time_host",
        latency_ns=_LATENCY_NS,
        latency_sigma_ns=1e6,
    )
    with EpisodeWriter(path, metadata, durable=False) as writer:
        add_intrinsics(writer, "rgb", CAMERA, method="the simulator's own")
        stream = writer.add_stream(
            "pose", kind="pose", clock=clock, frames=Frames(parent="world", child="tcp")
        )
        stream.append(time_ns, poses, time_host=time_ns + _LATENCY_NS)
