"""A tactile group of a store: what its four arrays say becomes streams."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from exumi_converters.oxt.contract import (
    INDEX,
    NUMBERED_TYPES,
    SENSORS,
    THUMB,
    TORQUE_AREAS,
    UNKNOWN_SENSOR,
    TactileKey,
    tactile_key,
)
from exumi_converters.oxt.layout import Layout, picture_shape, stated_names
from exumi_converters.oxt.numbers import add_cells, read_text
from exumi_converters.oxt.pictures import add_pads
from exumi_converters.oxt.stamps import Timeline
from exumi_converters.zarr2_files.numbers import read_numbers
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.errors import SourceError
from exumi_data.model import QualityNote, Sensor
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["Names", "add_group"]

_MODELS = {theirs.lower(): ours for ours, theirs in SENSORS.items()}
_SIDES: Mapping[int, Literal["left", "right"]] = {THUMB: "left", INDEX: "right"}
_MOST_SIDE = 4096
_COMPONENT = re.compile(r"(f|t)[a-z_]*")


class Names:
    """Gives tactile streams their names: as the store states, by fingers of a gripper, or by areas.

    Parameters
    ----------
    layout : Layout
        Whose other streams have names already.
    """

    def __init__(self, layout: Layout) -> None:
        groups = (layout.cameras, layout.poses, layout.widths)
        self._taken = {name for group in groups for name in group.values()}
        self._several_hands = len({key.partition("_")[0] for key in layout.tactile}) > 1

    def take(self, parts: TactileKey, areas: Sequence[int], about: Mapping[str, Any]) -> list[str]:
        """Name the streams of a group.

        Parameters
        ----------
        parts : TactileKey
        areas : sequence of int
        about : mapping
            What the store says of it.
        """
        stated = stated_names(about)
        if len(stated) != len(areas) or self._taken & set(stated):
            stated = [self._given(parts, area, areas) for area in areas]
        self._taken |= set(stated)
        return stated

    def _given(self, parts: TactileKey, area: int, areas: Sequence[int]) -> str:
        hand = f"{parts.side}_" if self._several_hands else ""
        group = re.sub(r"[^a-z0-9]+", "_", parts.group.lower()).strip("_")
        words = "" if group == "gripper" else f"_{group}"
        end = _SIDES[area] if set(areas) <= set(_SIDES) else str(area)
        name = f"{hand}tactile{words}"[:50] + f"_{end}"
        while name in self._taken:
            name += "_2"
        self._taken.add(name)
        return name


def add_group(
    writer: EpisodeWriter,
    group: Mapping[str, Rows],
    timeline: Timeline,
    about: Mapping[str, Any],
    names: Names,
) -> int:
    """Store a tactile group.

    Parameters
    ----------
    writer : EpisodeWriter
    group : mapping of str to Rows
        ``data``, ``area``, ``sensor`` and ``type``.
    timeline : Timeline
    about : mapping
        What the store says of it.
    names : Names

    Returns
    -------
    int
        Frames or samples written.

    Raises
    ------
    SourceError
        Sensor, type or areas are not what the contract allows, or change within the episode.
    """
    data = group["data"]
    parts = tactile_key(data.name)
    if parts is None:
        raise SourceError("is no tactile group", where=data.meta.path)
    kind = _one(read_text(group["type"]), group["type"])
    sensor = _one(read_text(group["sensor"]), group["sensor"])
    areas = _areas(writer, group["area"], data.meta.shape[1])
    if kind not in ("image", *NUMBERED_TYPES):
        known = ", ".join(("image", *NUMBERED_TYPES))
        raise SourceError(
            f"{group['type'].name} is {kind[:80]!r}; types are {known}",
            where=data.meta.path,
            fix="Mend the store.",
        )
    fault = _fault(kind, data, areas, about)
    if fault is not None:
        message = f"{data.name} was left out: {fault}"
        writer.metadata.quality.append(
            QualityNote(code="not-converted", message=message, severity="info")
        )
        return 0
    streams = names.take(parts, areas, about)
    gripper = set(areas) <= set(_SIDES)
    sensors = [_sensor(sensor, _SIDES.get(area) if gripper else None) for area in areas]
    if kind == "image":
        return add_pads(writer, streams, sensors, data, timeline)
    return add_cells(writer, streams, sensors, data, timeline, about)


def _one(values: np.ndarray, rows: Rows) -> str:
    """Return the one string that all steps of an episode have."""
    different = np.flatnonzero(values != values[0])
    if len(different) or not str(values[0]):
        place = int(different[0]) if len(different) else 0
        said = f"changes from {str(values[0])[:80]!r} to {str(values[place])[:80]!r}"
        raise SourceError(
            f"{rows.name} {said if len(different) else 'is empty'} at step {place} of the episode",
            where=rows.meta.path,
            fix="Mend the store.",
        )
    return str(values[0])


def _areas(writer: EpisodeWriter, rows: Rows, pads: int) -> list[int]:
    values = read_numbers(writer, rows, None).reshape(len(rows), pads)
    changed = np.flatnonzero((values != values[0]).any(axis=1))
    areas = [int(area) for area in values[0]]
    if len(changed) or len(set(areas)) != pads or min(areas) < 0:
        raise SourceError(
            f"{rows.name} is {values[int(changed[0]) if len(changed) else 0].tolist()} at step "
            f"{int(changed[0]) if len(changed) else 0}, where it has to be one area a pad, the "
            "same throughout",
            where=rows.meta.path,
            fix="Mend the store.",
        )
    return areas


def _fault(kind: str, data: Rows, areas: Sequence[int], about: Mapping[str, Any]) -> str | None:
    """Say why a group of a sound description has no place in an episode."""
    shape = data.meta.shape[2:]
    if kind == "image":
        fits = data.meta.dtype.str == "|u1" and picture_shape(shape) is not None
        said = f"its images are {shape} {data.meta.dtype}, not (H, W, 3) uint8"
    elif data.meta.dtype.kind not in "biuf":
        fits, said = False, f"its values are {data.meta.dtype}"
    elif "components" in about:
        fits = len(areas) == 1 and _are_components(about["components"], shape)
        said = "its components do not fit its shape"
    elif set(areas) & set(TORQUE_AREAS):
        fits, said = False, "order and units of its forces and torques are not stated"
    else:
        fits = len(shape) == 2 and all(1 <= side <= _MOST_SIDE for side in shape)
        said = f"{shape} is no grid of cells of one number each"
    return None if fits else said


def _are_components(words: object, shape: tuple[int, ...]) -> bool:
    return (
        isinstance(words, list)
        and shape == (len(words),)
        and all(isinstance(word, str) and _COMPONENT.fullmatch(word) for word in words)
    )


def _sensor(text: str, side: Literal["left", "right"] | None) -> Sensor:
    plain = re.sub(r"[^a-z0-9.-]+", "-", text.lower()).strip("-")[:100]
    return Sensor(model=_MODELS.get(text.lower(), plain or UNKNOWN_SENSOR), side=side)
