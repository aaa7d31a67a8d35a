"""The sweep before a marker in a clip."""

from collections.abc import Iterable
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_data.clips.frames import clip_frames, clip_size, fitting
from exumi_data.clips.markers import MarkerSettings, MarkerView, as_track, marker_views
from exumi_data.errors import ExumiError
from exumi_data.model.calibration import Intrinsics
from exumi_data.synchronisation.sweep import MarkerTrack, SweepLimits

__all__ = ["find_sweep", "first_sweep"]

_NS = 1_000_000_000
# Longer without the marker, and it is another sweep.
_APART_NS = _NS
# So much of the sweep is enough, and a marker may stay in sight for the whole clip.
_SWEEP_NS = 12 * _NS
_STRETCH_NS = 40 * _NS
_LOOK_NS = 600 * _NS


def find_sweep(path: Path, camera: Intrinsics, settings: MarkerSettings) -> MarkerTrack | str:
    """Find the first sweep before a marker in a clip.

    Parameters
    ----------
    path : pathlib.Path
        The clip. Its first ten minutes are looked at.
    camera : Intrinsics
        Of the clip's camera.
    settings : MarkerSettings

    Returns
    -------
    MarkerTrack or str
        On the clip's clock: the liveliest part of the first stretch in which the marker is in
        sight for long enough. Or why there is none.
    """
    try:
        fitted = fitting(camera, *clip_size(path), path)
        found = first_sweep(clip_frames(path), fitted, settings)
    except ExumiError as error:
        return f"it has no gyroscope, and its frames do not help: {error}"
    return f"it has no gyroscope, and {found}" if isinstance(found, str) else found


def first_sweep(
    frames: Iterable[tuple[int, NDArray[np.uint8]]], camera: Intrinsics, settings: MarkerSettings
) -> MarkerTrack | str:
    """Find the first sweep before a marker in frames; of these, no more are asked for than needed.

    Parameters
    ----------
    frames : iterable of (int, (H, W[, C]) uint8)
        Time on the clip's clock, ns, and frame. The first ten minutes are looked at.
    camera : Intrinsics
        Of these frames.
    settings : MarkerSettings

    Returns
    -------
    MarkerTrack or str
        As `find_sweep`.
    """
    limits = SweepLimits()
    views: list[MarkerView] = []
    begun = looked = seen = 0
    early = takewhile(lambda frame: frame[0] < _LOOK_NS, frames)
    for time_ns, view in marker_views(early, camera, settings):
        looked += 1
        if views and time_ns - views[-1].time_ns > _APART_NS:
            if _is_long(views, limits):
                break
            views = []
        if view is None:
            continue
        seen += 1
        begun = begun if views else looked
        views.append(view)
        if time_ns - views[0].time_ns > _STRETCH_NS:
            break
    if not _is_long(views, limits):
        return (
            f"no sweep before marker {settings.number}, which was found in {seen} of {looked} "
            "frames"
        )
    return _liveliest(as_track(views, looked - begun + 1))


def _is_long(views: list[MarkerView], limits: SweepLimits) -> bool:
    if len(views) < limits.frames:
        return False
    return views[-1].time_ns - views[0].time_ns >= limits.seconds * _NS


def _liveliest(track: MarkerTrack) -> MarkerTrack:
    """Return the part of a track, of the length of a sweep, in which the marker goes furthest."""
    steps = np.linalg.norm(np.diff(track.position_m, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    ends = np.searchsorted(track.time_ns, track.time_ns + _SWEEP_NS, side="right")
    first = int((way[ends - 1] - way).argmax())
    part = slice(first, int(ends[first]))
    share = (part.stop - part.start) / len(track.time_ns)
    return MarkerTrack(
        track.time_ns[part],
        track.position_m[part],
        track.row[part],
        max(round(share * track.frames), part.stop - part.start),
    )
