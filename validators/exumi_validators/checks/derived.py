"""Derived arrays: that they are described, belong to a stream, and can be what they claim."""

from collections.abc import Iterator

import numpy as np

from exumi_data.standard import derived_name_fault
from exumi_validators.context import EXUMI, EpisodeContext, newer_minor
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = ["activity", "activity_parameters", "described", "names", "salient", "streams"]

_DOCUMENT = "derived/zarr.json"
_ACTIVITY_PARAMETERS = ("threshold", "size", "active_above")


@check("DRV-001")
def described(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the group says what is in it."""
    loaded = episode.load(_DOCUMENT)
    if loaded is None:
        if any(path.startswith("derived/") for path in episode.listing.files):
            yield problem("DRV-001", _DOCUMENT, detail="there is no derived/zarr.json")
    elif loaded.value is not None and episode.derived_document is None:
        yield problem(
            "DRV-001", _DOCUMENT, pointer=EXUMI, detail="the group has no attribute `exumi`"
        )


@check("DRV-003")
def streams(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that derived arrays belong to a stream that is there."""
    for key in episode.derived:
        if key.partition("/")[0] not in episode.stream_names:
            yield problem("DRV-003", _DOCUMENT, pointer=(*EXUMI, "items", key), found=key)


@check("DRV-007")
def names(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that derived arrays have a name that means something. A newer version may know more."""
    if newer_minor((episode.derived_document or {}).get("version")):
        return
    for key in episode.derived:
        stream, _, name = key.partition("/")
        model = episode.streams.get(stream)
        detail = derived_name_fault(name, model.kind if model else None)
        if detail:
            pointer = (*EXUMI, "items", key)
            yield problem("DRV-007", _DOCUMENT, pointer=pointer, found=key, detail=detail)


@check("DRV-006")
def activity_parameters(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that activity comes with the thresholds that made it."""
    for key, item in episode.derived.items():
        if not key.endswith("/activity"):
            continue
        stated = {key for key, value in item.parameters.items() if _is_number(value)}
        lacking = [name for name in _ACTIVITY_PARAMETERS if name not in stated]
        if lacking:
            pointer = (*EXUMI, "items", key, "parameters")
            yield problem("DRV-006", _DOCUMENT, pointer=pointer, expected=", ".join(lacking))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


@check("DRV-004")
def activity(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that activity is a fraction."""
    for key in episode.derived:
        path = f"derived/{key}"
        if not key.endswith("/activity"):
            continue
        for start, (values,) in episode.blocks(path):
            wrong = ~((values >= 0) & (values <= 1))
            if wrong.any():
                row = int(wrong.argmax())
                yield problem("DRV-004", path, index=start + row, found=float(values[row]))
                break


@check("DRV-005")
def salient(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that salient frames are frames of the stream, in order."""
    for key in episode.derived:
        stream, _, name = key.partition("/")
        count = episode.count(stream)
        if name == "salient" and count is not None:
            yield from _salient_problems(episode, f"derived/{key}", count)


def _salient_problems(episode: EpisodeContext, path: str, count: int) -> Iterator[Problem]:
    last = np.array([-1], dtype=np.int64)
    for start, (values,) in episode.blocks(path):
        outside = (values < 0) | (values >= count)
        back = values <= np.concatenate((last, values[:-1]))
        wrong = outside | back
        if wrong.any():
            row = int(wrong.argmax())
            detail = f"of {count} frames" if outside[row] else "which is not after the one before"
            found = int(values[row])
            yield problem("DRV-005", path, index=start + row, found=found, detail=detail)
            return
        last = values[-1:]
