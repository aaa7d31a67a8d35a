"""What becomes of each episode, and what is lost, from metadata and times alone."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from exumi_converters.exporter import ExportItem, ExportPlan, Loss
from exumi_converters.lerobot_dataset.features import (
    Features,
    Profile,
    choose,
    make_features,
    profile_of,
)
from exumi_converters.lerobot_dataset.layout import Declaration, DeclaredStream, fps_number
from exumi_converters.lerobot_dataset.options import LeRobotOptions, listed, told_rate
from exumi_converters.lerobot_dataset.ticks import (
    common_ticks,
    frames_at,
    tick_times,
)
from exumi_converters.report import Failure
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import ExumiError, UsageError
from exumi_data.model import UNKNOWN_LICENCE, EpisodeMetadata
from exumi_data.time import format_rate

__all__ = ["LOSES", "make_plan"]

LOSES: Mapping[str, str] = {
    "identity": "episodes are numbered",
    "start": "times count from the first frame of each episode",
    "task": "one sentence is kept: the instruction, or the name where there is none",
    "regime": "success is not kept; the regime is where all episodes have the same",
    "annotations": "are not kept",
    "people": "only the device's name is kept, as robot_type",
    "licence": "is kept where all episodes have the same",
    "quality": "notes are not kept",
    "source": "exumi_export.json names the episodes that it was made from",
    "calibration": "is not kept",
    "streams": "audio, extension kinds, and streams that not all episodes have are left out",
    "time": "one rate for all: nearest frames, interpolated poses and widths, ends and gaps cut",
    "raw-time": "is not kept",
    "clock": "times are the timeline's, no longer measured ones",
    "flags": "are not kept; samples that are flagged invalid count as missing",
    "gaps": "are not kept: there is none in what is written",
    "sensor": "nominal rates become the timeline's; the rest is in meta/exumi.json",
    "values": "interpolated at the ticks, and rounded to float32",
    "raw": "is not kept",
    "frame-bytes": "frames are encoded again, as video",
    "pixels": "frames are encoded again, with half the colour resolution; grey ones become colour",
    "reference": "reference images are not kept",
    "derived": "only activity is kept, at the ticks",
}
"""Facets that do not survive, and what happens to them."""

_FEWEST = 2  # an action is the next frame's state
_BYTES_PER_PIXEL = 0.02
_NS_PER_MS = 1e6


def make_plan(dataset: Dataset, told: LeRobotOptions) -> ExportPlan:
    """Plan an export.

    Raises
    ------
    UsageError
        An option makes no sense, or no layout fits the episodes.
    """
    profiles = []
    for episode in dataset:
        with episode:
            profiles.append(profile_of(episode))
    shapes = choose(profiles, listed(told.streams))
    refused = {p.id: why for p in profiles if (why := p.fault(shapes)) is not None}
    fitting = [profile for profile in profiles if profile.id not in refused]
    features = make_features(shapes, fitting)
    refused.update(_odd_sides(features, fitting))
    timeline = _timeline(told, features, fitting)
    fps = _rate(told, timeline, fitting)
    spans = _Spans(features, timeline, fps, cut=told.gaps == "cut")
    losses = _Losses(features, profiles, told)
    for episode in dataset:
        with episode:
            if episode.id not in refused:
                try:
                    why = spans.add(episode)
                except ExumiError as error:
                    why = str(error)
                if why is None:
                    losses.add(episode)
                else:
                    refused[episode.id] = why
    written = {name for name, _, _ in spans.items}
    return ExportPlan(
        layout=f"a LeRobotDataset v3.0 of {len(spans.items)} episodes at "
        f"{fps_number(fps):g} fps, {', '.join(features.streams)}",
        items=tuple(
            ExportItem(id=name, index=i, settings={"start_ns": start, "frames": frames})
            for i, (name, start, frames) in enumerate(spans.items)
        ),
        shared=_shared(told, features, timeline, fps, [p for p in fitting if p.id in written]),
        losses=(*losses.of_documents(), *losses.of_streams(spans)),
        refused=tuple(Failure(p.id, refused[p.id]) for p in profiles if p.id in refused),
        notices=_notices(told, features, timeline, fps),
        estimated_bytes=spans.estimated_bytes(),
    )


def _odd_sides(features: Features, profiles: Sequence[Profile]) -> dict[str, str]:
    for image in features.images:
        if image.height % 2 or image.width % 2:
            why = (
                f"its {image.stream} is {image.width}x{image.height}: videos with half the colour "
                "resolution need even sides; exumi prepare makes frames of another size"
            )
            return {profile.id: why for profile in profiles}
    return {}


def _timeline(told: LeRobotOptions, features: Features, profiles: Sequence[Profile]) -> str | None:
    """Return the stream that the ticks are taken from."""
    images = [image.stream for image in features.images]
    if told.timeline:
        if told.timeline not in images:
            raise UsageError(
                f"Invalid timeline ({told.timeline}): no image stream of that name is written",
                fix=f"There are: {', '.join(images) or 'none'}.",
            )
        return told.timeline
    cameras = [name for name in images if profiles and profiles[0].shapes[name][0] == "rgb"]
    return next(iter((*cameras, *images)), None)


def _rate(told: LeRobotOptions, timeline: str | None, profiles: Sequence[Profile]) -> Fraction:
    if told.fps:
        return told_rate(told.fps)
    if timeline is None:
        raise UsageError("no image stream gives the timeline its rate", fix="Name it: -o fps=30.")
    if not profiles:
        return Fraction(1)  # nothing will be written
    rates = Counter(profile.rates[timeline] for profile in profiles)
    if len(rates) > 1 or None in rates:
        named = sorted((rate or "none stated", count) for rate, count in rates.items())
        said = ", ".join(f"{rate} ({count} episodes)" for rate, count in named)
        raise UsageError(
            f"stream {timeline!r} gives the timeline no one nominal rate: {said}",
            fix="Name the rate: -o fps=30.",
        )
    return told_rate(next(iter(rates)) or "")


@dataclass(slots=True)
class _Counted:
    """What becomes of the samples of one stream."""

    samples: int = 0
    ticks: int = 0
    unused: int = 0
    repeated: int = 0
    farthest_ns: int = 0


@dataclass(slots=True)
class _Spans:
    """Which ticks of each episode are written."""

    features: Features
    timeline: str | None
    fps: Fraction
    cut: bool
    items: list[tuple[str, int, int]] = field(default_factory=list)
    counted: dict[str, _Counted] = field(default_factory=dict)
    shortened: int = 0
    lost_ticks: int = 0

    def add(self, episode: Episode) -> str | None:
        """Take an episode; else return why it is refused."""
        streams = [episode[name] for name in self.features.streams]
        ticks = common_ticks(streams, self.timeline, self.fps)
        if isinstance(ticks, str):
            return ticks
        first, stop = 0, len(ticks.valid)
        if not ticks.valid.all():
            if not self.cut:
                missing = ", ".join(f"{name} at {n} frames" for name, n in ticks.gaps.items())
                return (
                    f"it has gaps: no sample within reach of {missing} of {len(ticks.valid)}; "
                    "-o gaps=cut writes the longest stretch without one"
                )
            first, stop = ticks.longest()
            self.shortened += 1
            self.lost_ticks += len(ticks.valid) - (stop - first)
        if stop - first < _FEWEST:
            return f"its streams overlap for {stop - first} frames; at least {_FEWEST} are needed"
        at = tick_times(ticks.start_ns, first, stop, self.fps)
        for stream in streams:
            self._count(stream, at)
        self.items.append((episode.id, int(at[0]), stop - first))
        return None

    def _count(self, stream: StreamView, at: np.ndarray) -> None:
        counted = self.counted.setdefault(stream.name, _Counted())
        counted.samples += len(stream)
        counted.ticks += len(at)
        if stream.is_image:
            rows = frames_at(stream, at)
            used = len(np.unique(rows))
            counted.unused += len(stream) - used
            counted.repeated += len(rows) - used
            farthest = int(np.abs(stream.time[rows] - at).max())
            counted.farthest_ns = max(counted.farthest_ns, farthest)

    def estimated_bytes(self) -> int:
        frames = sum(frames for _, _, frames in self.items)
        pixels = sum(image.height * image.width for image in self.features.images)
        numbers = sum(len(vector.names) for vector in self.features.vectors)
        return round(frames * (pixels * _BYTES_PER_PIXEL + 8 * numbers + 64))


@dataclass(slots=True)
class _Losses:
    """What the episodes hold that LeRobot has no place for."""

    features: Features
    profiles: Sequence[Profile]
    told: LeRobotOptions
    documents: set[str] = field(default_factory=set)
    streams: set[tuple[str, str]] = field(default_factory=set)

    def add(self, episode: Episode) -> None:
        """Look at an episode that is written."""
        self.documents.update(_documents(episode.metadata))
        for name in self.features.streams:
            self.streams.update((facet, name) for facet in _of_stream(episode[name]))
        for key in episode.derived.items if episode.derived else ():
            self.streams.add(("derived", key.partition("/")[0]))

    def of_documents(self) -> Iterator[Loss]:
        """Yield what is lost of the episodes' own metadata."""
        for facet in ("licence", "regime"):
            if len({getattr(profile, facet) for profile in self.profiles}) > 1:
                self.documents.add(facet)
        for facet in LOSES:
            if facet in self.documents:
                yield Loss(facet=facet, detail=LOSES[facet])

    def of_streams(self, spans: _Spans) -> Iterator[Loss]:
        """Yield what is lost of the streams, in the order of their names."""
        yield from self._left_out()
        for name in self.features.streams:
            counted = spans.counted.get(name)
            if counted is None:
                continue
            yield Loss(facet="time", detail=_time_detail(counted, spans), stream=name)
            image = next((i for i in self.features.images if i.stream == name), None)
            if image is None:
                yield Loss(facet="values", detail=LOSES["values"], stream=name)
            else:
                how = f"encoded again as {self.told.codec}, crf {self.told.crf}"
                yield Loss(facet="frame-bytes", detail=how, stream=name)
                how = f"{how}, with half the colour resolution"
                yield Loss(facet="pixels", detail=how, stream=name)
            for facet in LOSES:
                if (facet, name) in self.streams:
                    yield Loss(facet=facet, detail=LOSES[facet], stream=name)

    def _left_out(self) -> Iterator[Loss]:
        why: dict[str, str] = {}
        for profile in self.profiles:
            for name, kind in profile.others.items():
                why[name] = f"streams of the kind {kind} have no place there"
            for name in profile.shapes:
                if name not in self.features.streams:
                    why[name] = (
                        "is not among those to write"
                        if self.told.streams
                        else "not all episodes have it"
                    )
        for name, reason in sorted(why.items()):
            yield Loss(facet="streams", detail=reason, stream=name)


def _time_detail(counted: _Counted, spans: _Spans) -> str:
    detail = f"{counted.samples} samples become {counted.ticks} ticks of the timeline"
    if counted.farthest_ns or counted.unused or counted.repeated:
        detail += (
            f": {counted.unused} frames are not used, {counted.repeated} ticks repeat one, frames "
            f"are up to {counted.farthest_ns / _NS_PER_MS:.1f} ms away from their ticks"
        )
    if spans.shortened:
        detail += (
            f"; {spans.shortened} episodes are cut at gaps, which costs {spans.lost_ticks} ticks"
        )
    return detail


def _documents(metadata: EpisodeMetadata) -> Iterator[str]:
    yield from ("identity", "source")
    if metadata.start is not None:
        yield "start"
    if metadata.task.instruction != metadata.task.name:
        yield "task"
    if metadata.success is not None:
        yield "regime"
    if metadata.annotations is not None:
        yield "annotations"
    if metadata.operator or metadata.site or metadata.device or metadata.embodiment:
        yield "people"
    if metadata.quality:
        yield "quality"
    if metadata.calibration:
        yield "calibration"


def _of_stream(stream: StreamView) -> Iterator[str]:
    model: Any = stream.metadata
    arrays = set(model.arrays)
    yield "clock"
    yield "sensor"
    if arrays & {"time_host", "time_device", "sequence"}:
        yield "raw-time"
    for name in ("flags", "raw", "reference"):
        if name in arrays:
            yield name
    if model.gaps or model.lost:
        yield "gaps"


def _shared(
    told: LeRobotOptions,
    features: Features,
    timeline: str | None,
    fps: Fraction,
    profiles: Sequence[Profile],
) -> dict[str, Any]:
    """Return what all parts are written by."""
    robots = {profile.robot for profile in profiles}
    action = told.action == "next-state" and features.state is not None
    regimes: set[Any] = {profile.regime for profile in profiles}
    declaration = Declaration(
        fps=format_rate(fps),
        timeline=timeline,
        action="observation.state of the next frame; the last frame repeats its own"
        if action
        else "none",
        licence=_licence({profile.licence for profile in profiles}),
        regime=regimes.pop() if len(regimes) == 1 else None,
        streams={
            name: _common([profile.declared[name] for profile in profiles])
            for name in features.streams
        }
        if profiles
        else {},
    )
    return {
        "fps": format_rate(fps),
        "codec": told.codec,
        "crf": told.crf,
        "keyframes": told.keyframes,
        "action": action,
        "robot_type": robots.pop() if len(robots) == 1 else None,
        "features": features.as_json(),
        "declaration": declaration.model_dump(mode="json", exclude_none=True)
        | {"timeline": timeline},
    }


def _licence(licences: set[str]) -> str:
    if UNKNOWN_LICENCE in licences or not licences:
        return UNKNOWN_LICENCE
    if len(licences) == 1:
        return next(iter(licences))
    # What is under several licences at once is used by the rules of all.
    return " AND ".join(f"({licence})" for licence in sorted(licences))


def _common(said: Sequence[DeclaredStream]) -> DeclaredStream:
    """Return what is said of a stream in all episodes."""
    first = said[0]
    differing = {
        name: None
        for name in DeclaredStream.model_fields
        if any(getattr(other, name) != getattr(first, name) for other in said)
    }
    return first.model_copy(update=differing)


def _notices(
    told: LeRobotOptions, features: Features, timeline: str | None, fps: Fraction
) -> tuple[str, ...]:
    begins = f"at the first frame of {timeline}" if timeline else "at the first sample"
    notices = [
        f"the timeline has {fps_number(fps):g} frames a second ({format_rate(fps)}) and begins "
        f"{begins} at which all streams have begun"
    ]
    if told.action == "next-state" and features.state is None:
        notices.append("there is no action: no pose or width gives a state")
    elif told.action == "next-state":
        notices.append(
            "action is declared, not measured: the state of the next frame; the last frame repeats "
            "its own"
        )
    return tuple(notices)
