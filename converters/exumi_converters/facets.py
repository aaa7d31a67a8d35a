"""What an episode holds, piece by piece: the words in which an exporter says what it loses.

`differences` compares two episodes in the same words, so that a round trip can be held against
what was announced.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from exumi_data.episode import Episode, StreamView
from exumi_data.model import EpisodeMetadata
from exumi_data.model.documents import dump

__all__ = ["FACETS", "differences"]

FACETS: Mapping[str, str] = {
    "identity": "id and revision of the episode",
    "start": "when it began (UTC)",
    "task": "task and instruction",
    "regime": "demonstration, play or touch; success",
    "annotations": "object, part, trial, labels, segments",
    "people": "operator, site, device, embodiment",
    "licence": "licence",
    "quality": "quality notes",
    "source": "where it came from and what was lost on the way",
    "calibration": "calibration items, with their arrays",
    "streams": "streams of kinds that have no place there",
    "stream-names": "names of the streams",
    "time": "the time of every sample, at the sensor's own rate",
    "raw-time": "host and device times, sequence numbers",
    "clock": "how times came about: stamp point, offset, drift, latency, with uncertainty",
    "flags": "flags of samples",
    "gaps": "gaps and loss counters",
    "sensor": "sensor, description, nominal rate, units and reference frames of a stream",
    "values": "values of poses, widths, wrenches, taxels, audio, bit for bit",
    "raw": "the device's own values beside transformed ones",
    "frame-bytes": "the camera's own bytes (JPEG, video file)",
    "pixels": "the pixels of every frame",
    "reference": "reference images of tactile sensors",
    "derived": "activity, salient frames and other derived arrays",
}
"""Name of each facet to what it is."""

_DOCUMENT: Mapping[str, tuple[str, ...]] = {
    "identity": ("id", "revision"),
    "start": ("start",),
    "task": ("task",),
    "regime": ("regime", "success"),
    "annotations": ("annotations",),
    "people": ("operator", "site", "device", "embodiment"),
    "licence": ("licence",),
    "quality": ("quality",),
    "source": ("source",),
}


def differences(before: Episode, after: Episode) -> frozenset[str]:
    """Find the facets in which two episodes differ.

    A stream that the second lacks counts as ``streams``, and is not compared further. Streams of
    other names are compared where there is exactly one of the same kind on both sides.

    Parameters
    ----------
    before, after : Episode

    Returns
    -------
    frozenset of str
        Keys of `FACETS`.
    """
    found = set(_document_differences(before.metadata, after.metadata))
    found |= set(_calibration(before, after))
    pairs, missing, renamed = _pairs(before, after)
    if missing:
        found.add("streams")
    if renamed:
        found.add("stream-names")
    for one, other in pairs:
        found |= set(_stream(one, other))
    if _derived(before, pairs) != _derived(after, [(b, a) for a, b in pairs]):
        found.add("derived")
    return frozenset(found)


def _document_differences(before: EpisodeMetadata, after: EpisodeMetadata) -> Iterator[str]:
    old, new = dump(before), dump(after)
    for facet, keys in _DOCUMENT.items():
        if any(_stated(old.get(key)) != _stated(new.get(key)) for key in keys):
            yield facet


def _stated(value: Any) -> Any:
    """Return a value so that what is absent and what is empty are the same."""
    return None if value in (None, [], {}) else value


def _calibration(before: Episode, after: Episode) -> Iterator[str]:
    old, new = dump(before.metadata), dump(after.metadata)
    if _stated(old.get("calibration")) != _stated(new.get("calibration")):
        yield "calibration"
        return
    for name, item in before.metadata.calibration.items():
        if item.array is not None and not np.array_equal(
            before.calibration_array(name), after.calibration_array(name)
        ):
            yield "calibration"
            return


def _pairs(
    before: Episode, after: Episode
) -> tuple[list[tuple[StreamView, StreamView]], list[str], list[str]]:
    """Pair streams by name, then by being the only ones of their kind that are left."""
    pairs = [(before[name], after[name]) for name in before if name in after]
    left = [before[name] for name in before if name not in after]
    free = [after[name] for name in after if name not in before]
    missing, renamed = [], []
    for stream in left:
        same = [other for other in free if other.kind == stream.kind]
        alone = sum(other.kind == stream.kind for other in left) == 1
        if len(same) == 1 and alone:
            pairs.append((stream, same[0]))
            renamed.append(stream.name)
        else:
            missing.append(stream.name)
    return pairs, missing, renamed


def _stream(before: StreamView, after: StreamView) -> Iterator[str]:
    checks: Mapping[str, Callable[[StreamView, StreamView], bool]] = {
        "time": _same_time,
        "raw-time": lambda a, b: all(
            _same_array(a, b, name) for name in ("time_host", "time_device", "sequence")
        ),
        "clock": lambda a, b: _same_keys(a, b, ("clock",)),
        "flags": lambda a, b: _same_array(a, b, "flags"),
        "gaps": lambda a, b: _same_keys(a, b, ("gaps", "lost")),
        "sensor": _same_description,
        "raw": lambda a, b: _same_array(a, b, "raw") and _same_keys(a, b, ("raw",)),
        "reference": lambda a, b: (
            _same_array(a, b, "reference") and _same_keys(a, b, ("reference",))
        ),
    }
    for facet, same in checks.items():
        if not same(before, after):
            yield facet
    if before.is_image:
        if not _same_pixels(before, after):
            yield "pixels"
        if not _same_bytes(before, after):
            yield "frame-bytes"
    elif not (_same_array(before, after, "data") and _same_array(before, after, "valid")):
        yield "values"


def _same_time(before: StreamView, after: StreamView) -> bool:
    return np.array_equal(before.time, after.time)


def _array(stream: StreamView, name: str) -> np.ndarray | None:
    return stream.array(name) if name in stream.metadata.arrays else None


def _same_array(before: StreamView, after: StreamView, name: str) -> bool:
    old, new = _array(before, name), _array(after, name)
    if old is None or new is None:
        return old is None and new is None
    exact = old.dtype.kind == "f"
    return old.dtype == new.dtype and np.array_equal(old, new, equal_nan=exact)


def _same_keys(before: StreamView, after: StreamView, keys: tuple[str, ...]) -> bool:
    old, new = dump(before.metadata), dump(after.metadata)
    return all(_stated(old.get(key)) == _stated(new.get(key)) for key in keys)


def _same_description(before: StreamView, after: StreamView) -> bool:
    elsewhere = {"clock", "gaps", "lost", "raw", "reference", "images", "arrays"}
    old, new = dump(before.metadata), dump(after.metadata)
    keys = (set(old) | set(new)) - elsewhere
    return all(_stated(old.get(key)) == _stated(new.get(key)) for key in keys)


def _same_pixels(before: StreamView, after: StreamView) -> bool:
    if not after.is_image or len(before) != len(after):
        return False
    return all(
        np.array_equal(before.frames[index], after.frames[index]) for index in range(len(before))
    )


def _same_bytes(before: StreamView, after: StreamView) -> bool:
    """Whether what the camera or encoder made is there byte for byte."""
    old, new = _encoding(before), _encoding(after)
    if old == "array":
        return True
    if old != new or len(before) != len(after):
        return False
    if old == "encoded":
        return all(before.encoded(i) == after.encoded(i) for i in range(len(before)))
    files = before.metadata.images.files  # type: ignore[attr-defined]  # an image stream
    others = after.metadata.images.files  # type: ignore[attr-defined]  # an image stream
    return len(files) == len(others) and all(
        before.container(i) == after.container(i) for i in range(len(files))
    )


def _encoding(stream: StreamView) -> str | None:
    images = getattr(stream.metadata, "images", None)
    return None if images is None else str(images.encoding)


def _derived(
    episode: Episode, pairs: list[tuple[StreamView, StreamView]]
) -> dict[str, tuple[Any, ...]]:
    """Return the derived arrays of the streams that both have, under the first one's names."""
    if episode.derived is None:
        return {}
    kept = {own.name for own, _ in pairs}
    found: dict[str, tuple[Any, ...]] = {}
    for key, item in episode.derived.items.items():
        name, _, what = key.partition("/")
        array = episode.derived_array(key) if name in kept else None
        if array is not None:
            found[what] = (*found.get(what, ()), (dump(item), array.dtype.str, array.tobytes()))
    return found
