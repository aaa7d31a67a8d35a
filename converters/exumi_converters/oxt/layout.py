"""Which arrays of a store become which streams, by their names and shapes."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from exumi_converters.oxt.contract import (
    CAMERAS,
    INSTRUCTION,
    MARK,
    TIMESTAMPS,
    key_of,
    tactile_key,
)
from exumi_converters.oxt.options import OxtReadOptions
from exumi_converters.zarr2_files.buffer import Buffer
from exumi_converters.zarr2_files.metadata import ArrayMeta
from exumi_data.model.base import STREAM_NAME

__all__ = ["Layout", "Mark", "find_layout", "read_mark"]

_MOST_SIDE = 65535
_MOST_PADS = 64
_POSES = {"right_wrist_pose": "right", "left_wrist_pose": "left", "camera_ego_pose": "ego"}
_UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001}
_HAND = re.compile(r"(left|right)_hand_joints")
_WIDTH_M = re.compile(r"(.*_)?gripper_width_m")
_JOINTS = re.compile(r"(left|right)_arm_joints|supplementary_joints|(left|right)_hand_usage")


@dataclass(frozen=True, slots=True)
class Mark:
    """What a store that exUMI wrote says of itself; empty for other stores.

    Attributes
    ----------
    exporter : str or None
    task : str or None
    episodes : tuple of str
        Id of the episode that each of the store's was written from.
    arrays : mapping of str to mapping
        By key: names of the streams, units, reference frames.
    """

    exporter: str | None = None
    task: str | None = None
    episodes: tuple[str, ...] = ()
    arrays: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(slots=True)
class Layout:
    """Streams and the arrays that they come from.

    Attributes
    ----------
    cameras, poses, widths : dict of str to str
        Array to stream.
    scales : dict of str to float
        Of arrays of widths: metres a unit.
    tactile : list of str
        Keys of the data of tactile groups.
    left_out : dict of str to str
        Arrays that are not read, and why.
    about : dict of str to dict
        What the store says of its arrays.
    """

    cameras: dict[str, str] = field(default_factory=dict)
    poses: dict[str, str] = field(default_factory=dict)
    widths: dict[str, str] = field(default_factory=dict)
    scales: dict[str, float] = field(default_factory=dict)
    tactile: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    about: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def images(self) -> list[str]:
        """Arrays that hold most of the bytes."""
        return [*self.cameras, *self.tactile]

    @property
    def arrays(self) -> list[str]:
        """Names of all arrays that are read."""
        beside = [key_of(key, what) for key in self.tactile for what in ("area", "sensor", "type")]
        slots = [f"{key}_idx" for key in self.widths if _HAND.fullmatch(key)]
        read = [*self.cameras, *self.poses, *self.widths, *slots, *self.tactile, *beside]
        return [TIMESTAMPS, INSTRUCTION, *read]

    def json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)


def read_mark(attributes: Mapping[str, Any]) -> Mark:
    """Read what a store of ours says of itself; what is not as it should be is passed over."""
    found = attributes.get(MARK)
    if not isinstance(found, dict) or not isinstance(found.get("exporter"), str):
        return Mark()
    episodes = found.get("episodes")
    arrays = found.get("arrays")
    return Mark(
        exporter=found["exporter"][:100],
        task=found["task"] if isinstance(found.get("task"), str) else None,
        episodes=tuple(map(str, episodes)) if isinstance(episodes, list) else (),
        arrays={
            key: value
            for key, value in (arrays.items() if isinstance(arrays, dict) else ())
            if isinstance(value, dict)
        },
    )


def find_layout(buffer: Buffer, mark: Mark, told: OxtReadOptions) -> Layout:
    """Assign arrays to streams.

    Parameters
    ----------
    buffer : Buffer
    mark : Mark
    told : OxtReadOptions
    """
    layout = Layout(
        left_out=dict(buffer.refused), about={k: dict(v) for k, v in mark.arrays.items()}
    )
    arrays = {k: v for k, v in buffer.arrays.items() if k not in (TIMESTAMPS, INSTRUCTION)}
    names = _Names(mark)
    _find_cameras(layout, arrays, names)
    for key, word in _POSES.items():
        if key in arrays:
            _find_pose(layout, arrays[key], names, word, arrays)
    _find_widths(layout, arrays, names, told)
    _find_tactile(layout, arrays)
    known = {*layout.arrays, *layout.left_out}
    for key in arrays:
        if key not in known:
            joints = _JOINTS.fullmatch(key) or key.endswith("_idx")
            reason = "episodes have no place for joints" if joints else "no part of the contract"
            layout.left_out[key] = reason
    return layout


class _Names:
    """Gives streams their names: those that the store states, else those that are given here."""

    def __init__(self, mark: Mark) -> None:
        self._mark = mark
        self._taken: set[str] = set()

    def take(self, key: str, default: str) -> str:
        stated = stated_names(self._mark.arrays.get(key, {}))
        name = stated[0] if len(stated) == 1 and stated[0] not in self._taken else default
        while name in self._taken:
            name += "_2"
        self._taken.add(name)
        return name


def stated_names(about: Mapping[str, Any]) -> list[str]:
    """Return the names of streams that a store states for an array, if they are names."""
    names = about.get("streams")
    if not isinstance(names, list) or len(set(map(str, names))) != len(names):
        return []
    if not all(isinstance(name, str) and re.fullmatch(STREAM_NAME, name) for name in names):
        return []
    return names


def _find_cameras(layout: Layout, arrays: Mapping[str, ArrayMeta], names: _Names) -> None:
    found = [key for key in CAMERAS if key in arrays]
    for key in found:
        if picture_shape(arrays[key].shape[1:]) is None or arrays[key].dtype.str != "|u1":
            layout.left_out[key] = f"it is {_said(arrays[key])}, not (T, H, W, 3) uint8"
            continue
        short = key.removesuffix("_rgb").replace("camera_", "").replace("_camera", "")
        layout.cameras[key] = names.take(key, "rgb" if len(found) == 1 else f"rgb_{short}")


def picture_shape(shape: tuple[int, ...]) -> tuple[int, int, int] | None:
    """Return height, width and channels of images; None where they are none.

    Parameters
    ----------
    shape : tuple of int
        Of one step: (H, W, C), (C, H, W) or (H, W).
    """
    if len(shape) == 2:
        shape = (*shape, 1)
    if len(shape) != 3:
        return None
    if shape[2] not in (1, 3) and shape[0] in (1, 3):
        shape = (*shape[1:], shape[0])
    right = shape[2] in (1, 3) and all(1 <= side <= _MOST_SIDE for side in shape[:2])
    return (shape[0], shape[1], shape[2]) if right else None


def _find_pose(
    layout: Layout, meta: ArrayMeta, names: _Names, word: str, arrays: Mapping[str, ArrayMeta]
) -> None:
    if meta.shape[1:] != (6,) or meta.dtype.kind != "f":
        layout.left_out[meta.name] = f"it is {_said(meta)}, not (T, 6) of floating point"
        return
    both = "right_wrist_pose" in arrays and "left_wrist_pose" in arrays
    alone = word != "ego" and not both
    layout.poses[meta.name] = names.take(meta.name, "pose" if alone else f"pose_{word}")


def _find_widths(
    layout: Layout, arrays: Mapping[str, ArrayMeta], names: _Names, told: OxtReadOptions
) -> None:
    hands = [key for key in arrays if _HAND.fullmatch(key)]
    for key in hands:
        fault = _fault_of_hand(arrays, key)
        unit = told.gripper
        if unit == "auto":
            unit = layout.about.get(key, {}).get("unit")  # type: ignore[assignment]  # checked next
        if fault is None and str(unit) not in _UNITS:
            fault = (
                "the unit of a gripper's number is not stated; -o gripper=m (dm, cm, mm) says it"
            )
        if fault is not None:
            layout.left_out[key] = fault
            continue
        default = "width" if len(hands) == 1 else f"width_{key.partition('_')[0]}"
        layout.widths[key] = names.take(key, default)
        layout.scales[key] = _UNITS[str(unit)]
    if layout.widths or told.gripper == "skip":
        return
    found = [key for key in arrays if _WIDTH_M.fullmatch(key) and _is_scalar(arrays[key])]
    for key in found:
        layout.widths[key] = names.take(key, "width")
        layout.scales[key] = 1.0


def _is_scalar(meta: ArrayMeta) -> bool:
    return meta.shape[1:] in ((), (1,)) and meta.dtype.kind == "f"


def _fault_of_hand(arrays: Mapping[str, ArrayMeta], key: str) -> str | None:
    slots = arrays.get(f"{key}_idx")
    if not _is_scalar(arrays[key]):
        return "it is a hand of several joints, and episodes have no place for joints"
    if slots is None or slots.shape[1:] not in ((), (1,)) or slots.dtype.kind not in "iu":
        return f"{key}_idx does not say which joint it is"
    return None


def _find_tactile(layout: Layout, arrays: Mapping[str, ArrayMeta]) -> None:
    for key, meta in arrays.items():
        parts = tactile_key(key)
        if parts is None:
            continue
        if parts.what != "data":
            data = key.replace(f"_tactile_{parts.what}_", "_tactile_data_", 1)
            if data not in arrays:
                layout.left_out[key] = f"there is no {data}"
            continue
        faults = list(_faults_of_group(arrays, meta))
        if faults:
            layout.left_out[key] = "; ".join(faults)
            for other in {key_of(key, what) for what in ("area", "sensor", "type")} & set(arrays):
                layout.left_out[other] = f"{key} is not read"
        else:
            layout.tactile.append(key)


def _faults_of_group(arrays: Mapping[str, ArrayMeta], data: ArrayMeta) -> Iterator[str]:
    """Yield what is wrong with the arrays of a tactile group, as far as their headers tell."""
    if len(data.shape) < 3:
        yield f"it is {_said(data)}, not (T, N, ...)"
        return
    pads = data.shape[1]
    if not 1 <= pads <= _MOST_PADS:
        yield f"it has {pads} areas"
    for what, kinds, shape in (("area", "iu", (pads,)), ("sensor", "SU", ()), ("type", "SU", ())):
        key = key_of(data.name, what)
        meta = arrays.get(key)
        if meta is None:
            yield f"{key} is missing, or is not read"
        elif meta.dtype.kind not in kinds or meta.shape[1:] not in (shape, shape or (1,)):
            yield f"{key} is {_said(meta)}"


def _said(meta: ArrayMeta) -> str:
    return f"{meta.shape} {meta.dtype}"
