"""Tactile streams: frames, what differs from the reference, and how much of it."""

from typing import Final

import numpy as np
import rerun as rr

from exumi_data.calibration import rectification_of
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.model.streams import images_of
from exumi_data.stats.episode import active_above
from exumi_data.store import jpeg
from exumi_data.tactile.activity import ActivityMeter
from exumi_data.tactile.images import UInt8Array, representation, to_grey
from exumi_data.tactile.rectification import Rectifier
from exumi_data.view.curves import QUIET, Curve, colour_of, name_curve
from exumi_data.view.frames import Block
from exumi_data.view.log import Event, Log
from exumi_data.view.looks import begin_jpeg, jpeg_columns
from exumi_data.view.names import ACTIVITY, ViewOptions
from exumi_data.view.panels import Panel
from exumi_data.view.pictures import log_pictures

__all__ = ["DIFFERENCE_COLOURS", "difference_colours", "log_tactile"]

_GROUND = (13, 17, 23)
_CONVEX = (255, 183, 77)
_CONCAVE = (79, 156, 255)
_QUALITY = 85
_SALIENT_RADIUS = 4.0
_ACTIVITY = Panel("curves", ACTIVITY, "Activity: share of active pixels")


def difference_colours() -> UInt8Array:
    """Return the colour of each difference from the reference, (511, 3) uint8 RGB.

    Entry ``255 + d`` is that of a pixel that is d grey levels brighter than the reference: dark
    where nothing differs, towards orange where the representation's convex channel rises, towards
    blue where its concave channel does.
    """
    levels = np.arange(-255, 256)
    grey = levels.clip(0, None).astype(np.uint8)[None]
    reference = (-levels).clip(0, None).astype(np.uint8)[None]
    _, convex, concave = representation(grey, reference)[:, 0, :, None]
    ground, warm, cold = (np.array(c, np.float32) for c in (_GROUND, _CONVEX, _CONCAVE))
    mixed = ground + convex * (warm - ground) + concave * (cold - ground)
    return np.asarray(np.rint(mixed), np.uint8)


DIFFERENCE_COLOURS: Final = difference_colours()


class _Differences:
    """The pictures of differences of a tactile stream, made while its frames are logged."""

    def __init__(self, log: Log, stream: StreamView, path: str, reference: UInt8Array) -> None:
        begin_jpeg(log, path)
        self._time = stream.time
        self._reference = reference.astype(np.int16)
        self._block = Block(log, path, jpeg_columns)
        self.send = self._block.send

    def add(self, index: int, grey: UInt8Array | None) -> None:
        picture = None
        if grey is not None:
            colours = DIFFERENCE_COLOURS[255 + (grey - self._reference)]
            # Derived pictures keep their colours at full resolution.
            picture = jpeg.encode(colours, _QUALITY, chroma="444")
        self._block.add(int(self._time[index]), picture)


class _Measure:
    """The activity of a stream's frames, where it is not stored."""

    def __init__(self, episode: Episode, stream: StreamView, reference: UInt8Array) -> None:
        pixel_map = rectification_of(episode, stream.name)
        self._rectify = None if pixel_map is None else Rectifier(pixel_map)
        self._meter = ActivityMeter(self._straight(reference))
        self.activity = np.full(len(stream), np.nan)

    def add(self, index: int, grey: UInt8Array | None) -> None:
        if grey is not None:
            self.activity[index] = self._meter.measure(self._straight(grey))

    def _straight(self, grey: UInt8Array) -> UInt8Array:
        return grey if self._rectify is None else self._rectify(grey[..., None])[..., 0]


def log_tactile(
    log: Log, episode: Episode, stream: StreamView, options: ViewOptions
) -> list[Event]:
    """Log a tactile stream: frames, their difference from the reference, activity.

    Parameters
    ----------
    log : Log
    episode : Episode
    stream : StreamView
    options : ViewOptions

    Returns
    -------
    list of Event
        Frames that are missing.
    """
    base = f"/tactile/{stream.name}"
    reference = _reference_of(log, stream)
    stored = stream.activity
    differences = measure = None
    if reference is not None:
        differences = _Differences(log, stream, f"{base}/difference", reference)
        if stored is None:
            measure = _Measure(episode, stream, reference)

    def on_grey(index: int, grey: UInt8Array | None) -> None:
        for each in (differences, measure):
            if each is not None:
                each.add(index, grey)

    events = log_pictures(
        log,
        stream,
        f"{base}/image",
        options,
        on_grey=None if reference is None else on_grey,
    )
    log.place(Panel("tactile", f"{base}/image", stream.name))
    if differences is not None:
        differences.send()
        title = f"{stream.name}: difference"  # longer ones are cut
        log.place(Panel("difference", f"{base}/difference", title))
    if measure is not None:
        log.notes.append(f"{stream.name}: activity is not stored; it was measured for the view")
    activity = stored if measure is None else measure.activity
    if activity is not None:
        _log_activity(log, episode, stream, activity)
    return events


def _reference_of(log: Log, stream: StreamView) -> UInt8Array | None:
    """Return the grey reference, if there is one that fits."""
    images = images_of(stream.metadata)
    reference = stream.reference
    if reference is None or images is None:
        return None
    if reference.dtype != np.uint8 or reference.shape not in (
        (images.height, images.width, 1),
        (images.height, images.width, 3),
    ):
        found = f"`reference` is {reference.shape} {reference.dtype}"
        log.fault(stream.name, DamagedDataError(f"{found}: it does not fit the frames"))
        return None
    return to_grey(reference)


def _log_activity(log: Log, episode: Episode, stream: StreamView, activity: np.ndarray) -> None:
    path = f"{ACTIVITY}/{stream.name}"
    name_curve(log, Curve(path, stream.name, colour_of(stream.name)), _ACTIVITY)
    log.rows(path, stream.time, rr.Scalars.columns(scalars=activity.astype(np.float64)))
    above = active_above(episode, stream.name)
    limit = f"{ACTIVITY}/active_above/{above:g}".replace(".", "_")
    name_curve(log, Curve(limit, f"active above {above:g}", QUIET), _ACTIVITY, width=1.0)
    ends = np.unique(stream.time[[0, -1]]) if len(stream) else stream.time
    log.rows(limit, ends, rr.Scalars.columns(scalars=np.full(len(ends), above)))
    _log_salient(log, stream, activity)


def _log_salient(log: Log, stream: StreamView, activity: np.ndarray) -> None:
    salient = stream.salient
    if salient is None:
        return
    chosen = salient[(salient >= 0) & (salient < len(activity))]
    path = f"{ACTIVITY}/salient/{stream.name}"
    log.place(_ACTIVITY)
    look = rr.SeriesPoints(
        names=[f"{stream.name}, salient"],
        colors=[colour_of(stream.name) or QUIET],
        marker_sizes=[_SALIENT_RADIUS],
    )
    log.fixed(path, look)
    values = activity[chosen].astype(np.float64)
    log.rows(path, stream.time[chosen], rr.Scalars.columns(scalars=values))
