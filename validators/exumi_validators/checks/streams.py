"""What the metadata of a stream says must fit together: no array is opened for it."""

import math
from collections import Counter
from collections.abc import Iterator

from exumi_data.model.streams import (
    PoseStream,
    RgbStream,
    TactileStream,
    TaxelsStream,
    WidthStream,
    WrenchStream,
    images_of,
)
from exumi_data.standard import units
from exumi_data.store.images import MAX_FRAME_BYTES
from exumi_data.store.zarr_document import MAX_SHARD_BYTES
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = [
    "components",
    "corrected_time",
    "device_time",
    "frame_size",
    "known_arrays",
    "nominal_time",
    "positions",
    "raw_is_described",
    "raw_time",
    "raw_transform",
    "reference_is_described",
    "reference_is_there",
    "required_arrays",
    "twice_listed",
]

_THERE, _ABSENT = "there", "absent"


def _at(name: str, *fields: str) -> tuple[str, ...]:
    return (*EXUMI, "streams", name, *fields)


@check("STRM-001")
def required_arrays(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a stream lists the arrays that its kind requires."""
    for name, stream in episode.streams.items():
        for spec in episode.specs(stream).values():
            if spec.required and spec.name not in stream.arrays:
                yield problem("STRM-001", ROOT, pointer=_at(name, "arrays"), expected=spec.name)


@check("STRM-002")
def known_arrays(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a stream lists only arrays of its kind. A newer version may know more."""
    for name, stream in episode.streams.items():
        if episode.is_extension(stream) or episode.newer:
            continue
        for array in stream.arrays:
            if array not in episode.specs(stream):
                yield problem("STRM-002", ROOT, pointer=_at(name, "arrays"), found=array)


@check("STRM-003")
def twice_listed(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a stream lists no array twice."""
    for name, stream in episode.streams.items():
        for array, times in Counter(stream.arrays).items():
            if times > 1:
                yield problem("STRM-003", ROOT, pointer=_at(name, "arrays"), found=array)


@check("RAW-001")
def raw_is_described(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that ``raw`` is in the arrays exactly when it is described."""
    for name, stream in episode.streams.items():
        if not isinstance(stream, PoseStream | WidthStream | WrenchStream):
            continue
        there, described = "raw" in stream.arrays, stream.raw is not None
        if there != described:
            yield problem(
                "RAW-001",
                ROOT,
                pointer=_at(name, "raw"),
                found=_THERE if there else _ABSENT,
                expected=_THERE if described else _ABSENT,
            )


@check("RAW-002")
def raw_transform(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the transform from raw to data is a calibration item."""
    items = (episode.document or {}).get("calibration")
    names = items if isinstance(items, dict) else {}
    for name, stream in episode.streams.items():
        if not isinstance(stream, PoseStream | WidthStream | WrenchStream) or not stream.raw:
            continue
        transform = stream.raw.transform
        if transform is not None and transform not in names:
            pointer = _at(name, "raw", "transform")
            yield problem("RAW-002", ROOT, pointer=pointer, found=transform)


@check("CLOCK-001")
def corrected_time(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a corrected time can be computed again. The raw time of video is its pts."""
    for name, stream in episode.streams.items():
        images = images_of(stream)
        from_pts = images is not None and images.encoding == "video"
        if not stream.clock.is_identity and stream.clock.raw_time is None and not from_pts:
            yield problem("CLOCK-001", ROOT, pointer=_at(name, "clock"))


@check("CLOCK-002")
def raw_time(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the raw time is among the arrays."""
    for name, stream in episode.streams.items():
        raw = stream.clock.raw_time
        if raw is not None and raw not in stream.arrays:
            yield problem("CLOCK-002", ROOT, pointer=_at(name, "clock", "raw_time"), found=raw)


@check("CLOCK-003")
def nominal_time(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that time without stamps names its rate and pretends no measurement."""
    for name, stream in episode.streams.items():
        if stream.clock.stamp_point != "nominal_rate":
            continue
        if stream.nominal_rate is None:
            detail = "the stamp point is nominal_rate, but there is no `nominal_rate`"
            yield problem("CLOCK-003", ROOT, pointer=_at(name), detail=detail)
        for raw in ("time_host", "time_device"):
            if raw in stream.arrays:
                detail = f"the stamp point is nominal_rate, but there is a measured `{raw}`"
                yield problem("CLOCK-003", ROOT, pointer=_at(name, "arrays"), detail=detail)


@check("CLOCK-004")
def device_time(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the device's time has a unit, and one of time where it is used."""
    for name, stream in episode.streams.items():
        pointer = _at(name, "time_device_unit")
        unit = stream.time_device_unit
        if "time_device" in stream.arrays and unit is None:
            yield problem(
                "CLOCK-004", ROOT, pointer=pointer, detail="`time_device` is without its unit"
            )
        elif stream.clock.raw_time == "time_device" and unit is not None:
            known = units().get(unit)
            if known is None or known.ns is None:
                detail = f"`time` is computed from a time in {unit}, which is no unit of time"
                yield problem("CLOCK-004", ROOT, pointer=pointer, detail=detail)


@check("IMG-001")
def frame_size(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a frame asks for a bounded amount of memory."""
    for name, stream in episode.streams.items():
        if isinstance(stream, RgbStream | TactileStream):
            images = stream.images
            size = math.prod((images.height, images.width, images.channels))
            most = MAX_SHARD_BYTES if images.encoding == "array" else MAX_FRAME_BYTES
            if size > most:
                pointer = _at(name, "images")
                yield problem("IMG-001", ROOT, pointer=pointer, expected=most, found=size)


@check("TACT-001")
def reference_is_described(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a reference says how it was had."""
    for name, stream in episode.streams.items():
        if not isinstance(stream, TactileStream):
            continue
        there, described = "reference" in stream.arrays, stream.reference is not None
        if there != described:
            yield problem(
                "TACT-001",
                ROOT,
                pointer=_at(name, "reference"),
                found=_THERE if there else _ABSENT,
                expected=_THERE if described else _ABSENT,
            )


@check("TACT-002")
def reference_is_there(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a tactile stream has a reference."""
    for name, stream in episode.streams.items():
        described = getattr(stream, "reference", None) is not None
        if isinstance(stream, TactileStream) and not described | ("reference" in stream.arrays):
            yield problem("TACT-002", ROOT, pointer=_at(name))


@check("WRENCH-001")
def components(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that components have names of their own."""
    for name, stream in episode.streams.items():
        if isinstance(stream, WrenchStream):
            for component, times in Counter(stream.components).items():
                if times > 1:
                    pointer = _at(name, "components")
                    yield problem("WRENCH-001", ROOT, pointer=pointer, found=component)


@check("TAX-001")
def positions(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that every taxel has a position, where positions are given."""
    for name, stream in episode.streams.items():
        if not isinstance(stream, TaxelsStream) or stream.positions_m is None:
            continue
        pointer = _at(name, "positions_m")
        cells = math.prod(stream.grid)
        if len(stream.positions_m) != cells:
            yield problem(
                "TAX-001",
                ROOT,
                pointer=pointer,
                expected=f"{cells} positions",
                found=f"{len(stream.positions_m)} positions",
            )
        for index, position in enumerate(stream.positions_m):
            if len(position) not in (2, 3):
                yield problem(
                    "TAX-001",
                    ROOT,
                    pointer=(*pointer, index),
                    expected="two or three numbers",
                    found=f"{len(position)} numbers",
                )
                break
