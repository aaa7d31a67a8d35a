"""When everything of a session was: places of clips, and how late poses and frames were stamped."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from exumi_converters.exumi_session.calibration_clip import (
    Seen,
    fingers_late,
    look_at,
    place_calibration,
)
from exumi_converters.exumi_session.camera_clock import (
    camera_clock,
    infer_zone_s,
    off_zone_s,
    stated_zone_s,
    zone_name,
)
from exumi_converters.exumi_session.hub import Hub, PoseSession
from exumi_converters.exumi_session.options import SessionOptions
from exumi_converters.exumi_session.touch_latency import grasps, touch_late
from exumi_data.clips.clip import Clip
from exumi_data.clips.markers import MarkerSettings
from exumi_data.engine import default_workers
from exumi_data.errors import UsageError
from exumi_data.model.calibration import Intrinsics
from exumi_data.synchronisation.matching import Candidate, CommonClock, Match, match_clips
from exumi_data.synchronisation.motion import of_gyro, of_poses
from exumi_data.synchronisation.placing import Placement
from exumi_data.synchronisation.turns import search_turns

__all__ = ["Late", "SessionTiming", "Told", "find_timing", "marker_settings"]

_NS = 1_000_000_000
_DAY_S = 86_400
ASSUMED_POSE_LATENCY_S, ASSUMED_POSE_SIGMA_S = 0.060, 0.030
"""Measured of exUMI's released hub code with a simulated headset (benchmarks/pose_age.py)."""
_BY_CLOCK = "exumi-camera-clock/1"
_TIMECODE_SIGMA_S, _ZONE_SIGMA_S = 0.1, 1.0
# The pictures of a camera are never further than this from its gyroscope.
_MOST_PICTURE_S = 0.1


@dataclass(frozen=True, slots=True)
class Late:
    """By how much stamps are late.

    Attributes
    ----------
    latency_ns : int
    sigma_ns : int or None
        None where nothing is known of it.
    method : str
    """

    latency_ns: int = 0
    sigma_ns: int | None = None
    method: str = "not known; taken to be none"


@dataclass(frozen=True, slots=True)
class Told:
    """Everything about time that the session as a whole tells.

    Attributes
    ----------
    hub : Hub
    session : PoseSession
    epoch_ns : int
        Unix time of the session's second 0.
    widths_m : (N,) float64
        At ``session.width_ns``; NaN where there is none.
    """

    hub: Hub
    session: PoseSession
    epoch_ns: int
    widths_m: NDArray[np.float64]


@dataclass(slots=True)
class SessionTiming:
    """What was found.

    Attributes
    ----------
    pose : Late
    fingers : dict of str to Late
    places : dict of str to Match
        Of the clips that were placed, by name: by the poses' stamps.
    refused : dict of str to str
        Why others were not.
    notices : list of str
    calibrated : str or None
        By which clip poses and pictures were brought into step; None where none tells.
    """

    pose: Late = Late()
    fingers: dict[str, Late] = field(default_factory=dict)
    places: dict[str, Match] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)
    calibrated: str | None = None


def find_timing(
    told: Told,
    clips: Mapping[str, Clip],
    calibration: Mapping[str, Clip],
    cameras: Mapping[str, str | None],
    camera: Intrinsics,
    options: SessionOptions,
) -> SessionTiming:
    """Find out when everything of a session was.

    Parameters
    ----------
    told : Told
    clips : mapping of str to Clip
        The demonstrations, by name.
    calibration : mapping of str to Clip
        The latency clips.
    cameras : mapping of str to (str or None)
        The camera of each of them, where it is known.
    camera : Intrinsics
        How the latency clips were filmed.
    options : SessionOptions
    """
    found = SessionTiming()
    clock = _stated_clock(told, clips, calibration, options, found)
    settings = marker_settings(options)
    # Decoding leaves the interpreter free: fingers are looked at while the clips are.
    with ThreadPoolExecutor(default_workers()) as pool:
        fingers = {side: pool.submit(_finger_latency, told, side) for side in told.hub.fingers}
        _time_clips(told, clips, calibration, cameras, camera, settings, clock, options, found)
        found.fingers = {side: late.result() for side, late in fingers.items()}
    return found


def _time_clips(  # noqa: PLR0913, PLR0917  # what was found of each kind
    told: Told,
    clips: Mapping[str, Clip],
    calibration: Mapping[str, Clip],
    cameras: Mapping[str, str | None],
    camera: Intrinsics,
    settings: MarkerSettings,
    clock: CommonClock | None,
    options: SessionOptions,
    found: SessionTiming,
) -> None:
    """Find out where every clip belongs, and how late poses are."""
    seen: dict[str, tuple[Seen, Placement]] = {}
    for name, clip in calibration.items():
        shown = look_at(clip.path, camera, settings)
        place = place_calibration(told.session, shown)
        if isinstance(place, str):
            found.notices.append(f"{name} does not calibrate: {place}")
        else:
            seen[name] = shown, place
    everything = {**calibration, **clips}
    for serial in sorted({cameras.get(name) or "" for name in everything}):
        own = {n: clip for n, clip in everything.items() if (cameras.get(n) or "") == serial}
        _place_all(told, own, seen, clips, clock, options, found)
    _pose_latency(told, seen, options, found)


def _finger_latency(told: Told, side: str) -> Late:
    spans = grasps(told.session.width_ns, told.widths_m)
    chunks, width_ns = told.hub.fingers[side], told.session.width_ns
    late = touch_late(chunks, spans, told.epoch_ns, width_ns, told.widths_m)
    if late is None:
        return Late()
    return Late(
        round(late.offset_s * _NS),
        round(late.sigma_s * _NS),
        f"{late.method}: {late.n_events} grasps of the session against the encoder",
    )


def marker_settings(options: SessionOptions) -> MarkerSettings:
    """Return which marker is looked for.

    Raises
    ------
    UsageError
        There is no such marker.
    """
    try:
        return MarkerSettings(options.marker_dictionary, options.marker, options.marker_side_m)
    except ValueError as error:
        raise UsageError(f"Invalid marker: {error}") from None


def _stated_clock(
    told: Told,
    clips: Mapping[str, Clip],
    calibration: Mapping[str, Clip],
    options: SessionOptions,
    found: SessionTiming,
) -> CommonClock | None:
    """Return what the time zone says of the camera's clock, where one is stated or fits."""
    epoch_s = told.epoch_ns / _NS
    first, last = told.hub.span_ns
    if options.timezone:
        zone = stated_zone_s(options.timezone, epoch_s)
        return camera_clock(zone, epoch_s)
    timed = [
        (clip.clock_s, clip.duration_s)
        for clip in (*clips.values(), *calibration.values())
        if clip.clock_s is not None
    ]
    inferred = infer_zone_s(timed, (first / _NS, last / _NS))
    if inferred is None:
        return None
    found.notices.append(
        f"the camera's clock is taken to show {zone_name(inferred)}: so its clips fall into the "
        "hub's recording"
    )
    return camera_clock(inferred, epoch_s)


def _place_all(  # one step of `find_timing`
    told: Told,
    own: Mapping[str, Clip],
    seen: Mapping[str, tuple[Seen, Placement]],
    clips: Mapping[str, Clip],
    clock: CommonClock | None,
    options: SessionOptions,
    found: SessionTiming,
) -> None:
    """Place the clips of one camera: by the gyroscope, else by its clock since the latency clip."""
    track = told.session.track
    candidates = [_candidate(name, clip) for name, clip in own.items()]
    matches, agreed = match_clips(of_poses(track.time_ns, track.poses), candidates, None, clock)
    by_name = {match.clip.name: match for match in matches}
    for name, clip in own.items():
        _refine(told, by_name[name], clip)
    anchors = [name for name in own if name in seen]
    shift_ns, picture_s = 0, None
    for name in anchors:
        match, (_, place) = by_name[name], seen[name]
        if match.placement is not None:
            apart = place.offset_ns - match.placement.offset_ns
            if abs(apart) <= _MOST_PICTURE_S * _NS:
                shift_ns = apart
                picture_s = float(np.hypot(place.sigma_s, place.camera_sigma_s))
        found.calibrated = name
    if agreed is not None and agreed.clips:
        _say_clock(agreed.ahead_s, told.epoch_ns / _NS, options, found)
    for name in own:
        if name not in clips:
            continue
        match = by_name[name]
        if match.placement is not None:
            if picture_s is not None:
                match.placement = replace(
                    match.placement,
                    offset_ns=match.placement.offset_ns + shift_ns,
                    camera_sigma_s=picture_s,
                )
            found.places[name] = match
            continue
        by_clock = _by_clock(own, name, {n: seen[n][1] for n in anchors}, clock, options)
        if by_clock is None:
            found.refused[name] = match.reason
            continue
        match.doubts.append(f"{match.reason}: placed by the camera's clock alone")
        match.placement = by_clock
        found.places[name] = match


def _refine(told: Told, match: Match, clip: Clip) -> None:
    """Refine a place that the gyroscope's speed has found by how far it turns."""
    place = match.placement
    if place is None or clip.gyro is None:
        return
    track = told.session.between(
        place.to_session(0) - _NS, place.to_session(round(clip.duration_s * _NS)) + _NS
    )
    middle = round(clip.duration_s * _NS / 2)
    found = search_turns(track.time_ns, track.poses, clip.gyro, place.to_session(middle) - middle)
    if found is not None and found.sigma_s < place.sigma_s:
        match.placement = replace(
            place,
            offset_ns=place.offset_ns + round(found.offset_s * _NS),
            sigma_s=found.sigma_s,
            method=f"{place.method}, {found.method}",
        )


def _candidate(name: str, clip: Clip) -> Candidate:
    return Candidate(
        name=name,
        turning=None if clip.gyro is None else of_gyro(clip.gyro),
        start_ns=0,
        stop_ns=round(clip.duration_s * _NS),
        clock_s=clip.clock_s,
        number=clip.number,
    )


def _by_clock(
    own: Mapping[str, Clip],
    name: str,
    anchors: Mapping[str, Placement],
    clock: CommonClock | None,
    options: SessionOptions,
) -> Placement | None:
    """Place a clip by the camera's clock: since a latency clip, or, if asked for, by its zone."""
    clip = own[name]
    if clip.clock_s is None:
        return None
    for other, place in anchors.items():
        at = own[other].clock_s
        if at is not None:
            since_s = (clip.clock_s - at + _DAY_S / 2) % _DAY_S - _DAY_S / 2
            start = place.to_session(0) + round(since_s * _NS)
            return _placed_by_clock(start, _TIMECODE_SIGMA_S, place.camera_sigma_s)
    if clock is not None and options.place_by_clock:
        start_s = (clip.clock_s - clock.ahead_s) % _DAY_S
        return _placed_by_clock(round(start_s * _NS), _ZONE_SIGMA_S, 0.0)
    return None


def _placed_by_clock(start_ns: int, sigma_s: float, camera_sigma_s: float) -> Placement:
    return Placement(
        offset_ns=start_ns,
        sigma_s=sigma_s,
        t_ref_ns=0,
        drift_ppm=0.0,
        drift_sigma_ppm=None,
        correlation=0.0,
        parts=0,
        disagreement_s=0.0,
        agrees=True,
        method=_BY_CLOCK,
        camera_sigma_s=camera_sigma_s,
    )


def _say_clock(
    ahead_s: float, epoch_s: float, options: SessionOptions, found: SessionTiming
) -> None:
    """Say what the camera's clock shows, and whether that is what was stated."""
    zone, off = off_zone_s(ahead_s, epoch_s)
    found.notices.append(
        f"the camera's clock shows {zone_name(zone)}, {abs(off):.1f} s "
        f"{'ahead of' if off > 0 else 'behind'} the hub's, by how the hand turned"
    )
    if options.timezone and stated_zone_s(options.timezone, epoch_s) % _DAY_S != zone % _DAY_S:
        found.notices.append(
            f"the time zone that was stated, {options.timezone}, is not that of the clips: their "
            "places are those of the gyroscope"
        )


def _pose_latency(
    told: Told,
    seen: Mapping[str, tuple[Seen, Placement]],
    options: SessionOptions,
    found: SessionTiming,
) -> None:
    if options.pose_latency_ms is not None:
        latency = round(options.pose_latency_ms * 1e6)
        found.pose = Late(latency, None, "stated by the user")
        return
    for name, (shown, place) in seen.items():
        late = fingers_late(told.session, told.widths_m, shown, place)
        if late is not None:
            sigma = float(np.hypot(late.sigma_s, place.sigma_s))
            found.pose = Late(
                round(late.offset_s * _NS),
                round(sigma * _NS),
                f"{name}: a sweep before a marker ({place.method}) tells the poses from the "
                f"camera, {late.method} the camera from the encoder",
            )
            return
    found.pose = Late(
        round(ASSUMED_POSE_LATENCY_S * _NS),
        round(ASSUMED_POSE_SIGMA_S * _NS),
        "assumed: what the released hub code was measured to have; nothing in this session tells",
    )
