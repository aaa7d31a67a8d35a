"""Which stream of an episode goes to which array, and what the array looks like."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from exumi_converters.oxt.contract import (
    CAMERAS,
    INDEX,
    SENSORS,
    THUMB,
    UNKNOWN_SENSOR,
    WRIST_TORQUE,
    tactile_key,
)
from exumi_converters.oxt.options import LEFT_OUT, OxtOptions, parse_assignments
from exumi_data.episode import Episode, StreamView

__all__ = ["Place", "Places", "find_places"]

_HEAD = ("ego", "head", "hmd", "headset")
_SCENE = ("main", "scene", "top", "front", "third", "external")
_FINGERS: Mapping[str, int] = {"left": THUMB, "right": INDEX}
_FINGER_NAMES: Mapping[int, str] = {THUMB: "thumb", INDEX: "index"}
_COMPONENTS = ("fx", "fy", "fz", "tx", "ty", "tz")

Kind = Literal["camera", "tactile", "pose", "gripper", "taxels", "wrench"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """An array, and the streams that fill it.

    Attributes
    ----------
    key : str
        Name of the array; of a tactile group, that of its data.
    kind : str
    streams : tuple of str
        Of tactile images one a pad, in the order of the areas; else one.
    row : tuple of int
        Shape of one step.
    dtype : str
    areas : tuple of int
    sensor : str
        As the contract names it.
    about : dict
        What the array's numbers are, for who reads it back.
    """

    key: str
    kind: Kind
    streams: tuple[str, ...]
    row: tuple[int, ...]
    dtype: str
    areas: tuple[int, ...] = ()
    sensor: str = ""
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def is_image(self) -> bool:
        """Whether its steps are images."""
        return self.kind in {"camera", "tactile"}

    @property
    def row_bytes(self) -> int:
        """Bytes of one step."""
        size = 1 if self.dtype == "|u1" else int(self.dtype[2:])
        return size * math.prod(self.row)

    def json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {**asdict(self), "streams": list(self.streams)}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Place":
        """Make it from what `json` returned."""
        tuples = {name: tuple(values[name]) for name in ("streams", "row", "areas")}
        return cls(**{**values, **tuples})


@dataclass(slots=True)
class Places:
    """What becomes of the streams of an episode.

    Attributes
    ----------
    found : dict of str to Place
        By key.
    left_out : dict of str to str
        Streams that have no place, and why.
    fault : str or None
        Why the contract cannot hold this episode.
    """

    found: dict[str, Place] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    fault: str | None = None

    def add(self, place: Place) -> None:
        """Take a place, unless it is taken."""
        if place.key in self.found:
            for stream in place.streams:
                self.left_out[stream] = f"the place {place.key} is taken"
        else:
            self.found[place.key] = place


def find_places(episode: Episode, told: OxtOptions) -> Places:
    """Assign streams to arrays: as the user says, the others by kind, name and side.

    Parameters
    ----------
    episode : Episode
    told : OxtOptions
    """
    places = Places()
    named = parse_assignments(told.streams)
    pads: dict[str, tuple[str | None, int]] = {}
    for name, (key, area) in named.items():
        if name in episode:
            _assign(places, pads, episode[name], key, area, told)
    left = {name: stream for name, stream in episode.streams.items() if name not in named}
    empty = [name for name, stream in left.items() if not len(stream)]
    for name in empty:
        places.left_out[name] = "it has no samples"
        del left[name]
    for name, key in _automatic(left, places, told):
        places.add(_numbers_place(episode[name], key, told))
    pads |= _automatic_pads(left, places)
    for place in _tactile_places(episode, pads, told):
        places.add(place)
    for name, stream in left.items():
        if stream.kind not in {"rgb", "tactile", "pose", "width", "taxels", "wrench"}:
            places.left_out[name] = f"the kind {stream.kind} has no place there"
    places.fault = _fault(places)
    return places


def _fault(places: Places) -> str | None:
    kinds = {place.kind for place in places.found.values()}
    if "camera" not in kinds:
        return "no camera has a place, and the contract asks for one"
    if not kinds & {"pose", "gripper"}:
        return "neither a pose nor a width has a place: there is nothing to derive actions from"
    return None


def _assign(
    places: Places,
    pads: dict[str, tuple[str | None, int]],
    stream: StreamView,
    key: str,
    area: int | None,
    told: OxtOptions,
) -> None:
    """Put a stream where the user wants it."""
    kinds = {"rgb": CAMERAS, "pose": ("_pose",), "width": ("_hand_joints",)}
    parts = tactile_key(key)
    if key == LEFT_OUT:
        places.left_out[stream.name] = "-o streams says so"
    elif not len(stream):
        places.left_out[stream.name] = "it has no samples"
    elif stream.kind == "tactile" and parts is not None:
        pads[stream.name] = (key, _area_of(stream) or THUMB if area is None else area)
    elif stream.kind in {"taxels", "wrench"} and parts is not None:
        places.add(_numbers_place(stream, key, told, area))
    elif key.endswith(tuple(kinds.get(stream.kind, ()))) and parts is None:
        places.add(_numbers_place(stream, key, told))
    else:
        places.left_out[stream.name] = f"a stream of the kind {stream.kind} does not fit {key}"


def _automatic(
    streams: Mapping[str, StreamView], places: Places, told: OxtOptions
) -> Iterator[tuple[str, str]]:
    """Yield stream and key of cameras and numbers that the user said nothing of."""
    yield from _cameras([s for s in streams.values() if s.kind == "rgb"], places, told.side)
    hand = {"pose": f"{told.side}_wrist_pose", "width": f"{told.side}_hand_joints"}
    for kind, key in hand.items():
        found = [s.name for s in streams.values() if s.kind == kind and not _is(s.name, _HEAD)]
        if len(found) == 1 and key not in places.found:
            yield found[0], key
        else:
            for name in found:
                places.left_out[name] = f"which of {len(found)} is {key}? Say -o streams=..."
        for stream in streams.values():
            if stream.kind == kind and _is(stream.name, _HEAD):
                places.left_out[stream.name] = "it is no gripper's; -o streams=... gives it a place"
    for name, stream in streams.items():
        if stream.kind == "taxels":
            yield name, f"{told.side}_tactile_data_{name}"
        elif stream.kind == "wrench":
            if set(stream.metadata.components) <= set(_COMPONENTS):  # type: ignore[attr-defined]  # a wrench
                yield name, f"{told.side}_tactile_data_{name}"
            else:
                places.left_out[name] = "it is no force and torque at the wrist"


def _cameras(streams: list[StreamView], places: Places, side: str) -> Iterator[tuple[str, str]]:
    free = [key for key in CAMERAS if key not in places.found]
    wrist = f"{side}_wrist_camera_rgb"
    for stream in streams:
        key = "camera_ego_rgb" if _is(stream.name, _HEAD) else wrist
        key = "camera_main_rgb" if _is(stream.name, _SCENE) else key
        if key in free:
            free.remove(key)
            yield stream.name, key
        else:
            places.left_out[stream.name] = f"the place {key} is taken; say -o streams=..."


def _is(name: str, words: tuple[str, ...]) -> bool:
    return bool(set(name.split("_")) & set(words))


def _area_of(stream: StreamView) -> int | None:
    """Return the area of a pad: thumb for left, index finger for right; None if nothing says."""
    sensor = stream.metadata.sensor
    side = None if sensor is None else sensor.side
    for word, area in _FINGERS.items():
        if side == word or (side is None and _is(stream.name, (word,))):
            return area
    return None


def _automatic_pads(
    streams: Mapping[str, StreamView], places: Places
) -> dict[str, tuple[str | None, int]]:
    """Return the areas of tactile streams that the user said nothing of."""
    tactile = [stream for stream in streams.values() if stream.kind == "tactile"]
    areas = {stream.name: _area_of(stream) for stream in tactile}
    if len(tactile) == 1:
        areas = {name: area or THUMB for name, area in areas.items()}
    found: dict[str, tuple[str | None, int]] = {}
    for name, area in areas.items():
        if area is None or list(areas.values()).count(area) > 1:
            places.left_out[name] = "which finger it is of is not known; say -o streams=..."
        else:
            found[name] = (None, area)
    return found


def _tactile_places(
    episode: Episode, pads: Mapping[str, tuple[str | None, int]], told: OxtOptions
) -> Iterator[Place]:
    """Put pads of one size and one sensor model into one group, thumb first."""
    groups: dict[tuple[str | None, tuple[int, ...], str], list[tuple[int, str]]] = {}
    for name, (key, area) in pads.items():
        size: tuple[int, ...] = episode[name].frames.shape[1:3]
        groups.setdefault((key, size, _sensor(episode[name])), []).append((area, name))
    automatic = sum(key is None for key, _, _ in groups)
    for (key, size, sensor), members in groups.items():
        members.sort()
        group = "gripper"
        if automatic > 1:
            group = f"gripper_{_FINGER_NAMES[members[0][0]]}"
        yield Place(
            key=key or f"{told.side}_tactile_data_{group}",
            kind="tactile",
            streams=tuple(name for _, name in members),
            row=(len(members), *size, 3),
            dtype="|u1",
            areas=tuple(area for area, _ in members),
            sensor=sensor,
        )


def _sensor(stream: StreamView) -> str:
    sensor = stream.metadata.sensor
    return UNKNOWN_SENSOR if sensor is None else SENSORS.get(sensor.model, sensor.model)


def _numbers_place(
    stream: StreamView, key: str, told: OxtOptions, area: int | None = None
) -> Place:
    """Return the place of a stream that has an array of its own."""
    metadata: Any = stream.metadata
    common: dict[str, Any] = {"key": key, "streams": (stream.name,)}
    if stream.kind == "rgb":
        row = (*stream.frames.shape[1:3], 3)
        return Place(kind="camera", row=row, dtype="|u1", **common)
    if stream.kind == "pose":
        turned = told.axes == "umi" and key.endswith("_wrist_pose")
        about = {
            "parent": metadata.frames.parent,
            "child": metadata.frames.child,
            "turned_about_z_deg": 90 if turned else 0,
        }
        return Place(kind="pose", row=(6,), dtype="<f4", about=about, **common)
    if stream.kind == "width":
        return Place(kind="gripper", row=(1,), dtype="<f4", about={"unit": "m"}, **common)
    if stream.kind == "taxels":
        dtype = stream.rows("data", 0, 1).dtype.newbyteorder("<").str
        return Place(
            kind="taxels",
            row=(1, *metadata.grid),
            dtype=dtype,
            areas=(_area_of(stream) or THUMB if area is None else area,),
            sensor=_sensor(stream),
            about={"unit": metadata.unit, "sign": metadata.sign, "offset": metadata.offset},
            **common,
        )
    return Place(
        kind="wrench",
        row=(1, len(metadata.components)),
        dtype="<f4",
        areas=(WRIST_TORQUE if area is None else area,),
        sensor=_sensor(stream),
        about={"components": list(metadata.components)},
        **common,
    )
