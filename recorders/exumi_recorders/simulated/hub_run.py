"""A hub run of many demonstrations with the card of the camera that filmed them, simulated."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from exumi_data.simulation.demonstrations import (
    Demonstrations,
    simulate_demonstrations,
    write_hub_session,
)
from exumi_data.simulation.gopro import SimulatedGoPro

__all__ = ["HubRun", "simulate_hub_run"]

_START = datetime(2026, 3, 1, 23, 55, tzinfo=UTC)  # the clock passes midnight
_ID = "01932c00-1f00-7000-8000-{:012x}"
_EDGE_S = 0.4
_TIME_ZONE_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HubRun:
    """What was simulated, and what is true of it.

    Attributes
    ----------
    session : pathlib.Path
        The episode that the hub recorded.
    clips : pathlib.Path
        The folder of the camera's clips.
    starts_s : dict of str to float
        When each clip that belongs to the session begins, seconds of it.
    missing_s : tuple of (float, float)
        Demonstrations of which there is no clip.
    foreign : tuple of str
        Clips of another run.
    drift_ppm : float
        By how much the camera's clock runs fast.
    demonstrations : Demonstrations
    """

    session: Path
    clips: Path
    starts_s: dict[str, float]
    missing_s: tuple[tuple[float, float], ...]
    foreign: tuple[str, ...]
    drift_ppm: float
    demonstrations: Demonstrations

    def true_s(self, name: str, clip_s: float) -> float:
        """Return the session's time of a time of a clip, seconds.

        Parameters
        ----------
        name : str
        clip_s : float
        """
        return self.starts_s[name] + clip_s / (1.0 + 1e-6 * self.drift_ppm)


def simulate_hub_run(  # noqa: PLR0913  # keyword-only options, each with a default
    folder: Path,
    *,
    demonstrations: int = 12,
    seed: int = 0,
    seconds: float = 8.0,
    missing: int = 1,
    foreign: int = 1,
    drift_ppm: float = 12.0,
    one_clock: bool = True,
    telemetry: bool = True,
) -> HubRun:
    """Write ``session.zarr`` and a folder ``clips``.

    The camera's clock is off by up to a minute, and set to another time zone.

    Parameters
    ----------
    folder : pathlib.Path
        New or empty.
    demonstrations : int, optional
    seed : int, optional
    seconds : float, optional
        About how long a demonstration is.
    missing, foreign : int, optional
        Demonstrations without a clip, and clips of another run.
    drift_ppm : float, optional
        By how much the camera's clock runs fast.
    one_clock : bool, optional
        Whether the clips' clocks are all off by the same; each by its own otherwise.
    telemetry : bool, optional
        Whether the clips have a gyroscope.
    """
    clips = folder / "clips"
    clips.mkdir(parents=True)
    run = simulate_demonstrations(demonstrations, seed=seed, seconds=seconds)
    session = write_hub_session(
        folder / "session.zarr",
        run,
        episode_id=_ID.format(seed),
        start=_START.strftime("%Y-%m-%dT%H:%M:%SZ"),
        seed=seed,
    )
    rng = np.random.default_rng([seed, 11])
    off_s = float(rng.uniform(-60.0, 60.0))
    left_out = set(rng.choice(np.arange(1, demonstrations - 1), missing, replace=False).tolist())
    starts: dict[str, float] = {}
    for number, (start, stop) in enumerate(run.spans_s):
        clock = off_s if one_clock else float(rng.uniform(-60.0, 60.0))
        before, after = rng.uniform(-_EDGE_S, _EDGE_S, 2)
        if number in left_out:
            continue
        name = f"GX01{number + 1:04d}.MP4"
        starts[name] = start + float(before)
        camera = SimulatedGoPro(clock_s=_TIME_ZONE_S + clock, drift_ppm=drift_ppm)
        camera.film(
            clips / name,
            run,
            (starts[name], stop + float(after)),
            session_start=_START,
            seed=number,
            telemetry=telemetry,
        )
    strangers = []
    for number in range(foreign):
        other = simulate_demonstrations(1, seed=seed + 1000 + number, seconds=seconds)
        name = f"GX01{demonstrations + 1 + number:04d}.MP4"
        camera = SimulatedGoPro(clock_s=_TIME_ZONE_S + off_s + number * seconds)
        camera.film(clips / name, other, other.spans_s[0], session_start=_START, seed=number)
        strangers.append(name)
    return HubRun(
        session=session,
        clips=clips,
        starts_s=starts,
        missing_s=tuple(run.spans_s[number] for number in sorted(left_out)),
        foreign=tuple(strangers),
        drift_ppm=drift_ppm,
        demonstrations=run,
    )
