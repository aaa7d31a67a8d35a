"""Which arrays of a replay buffer become which streams."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from exumi_converters.umi.channels import differences_of
from exumi_converters.zarr2_files.metadata import ArrayMeta

__all__ = ["TACTILE_COMBINED", "Layout", "find_layout", "is_image"]

TACTILE_COMBINED = "tactile_combined"

_ROBOT = re.compile(
    r"robot(0|[1-9][0-9]{0,2})_(eef_pos|eef_rot_axis_angle|gripper_width|demo_start_pose|demo_end_pose)"
)
_CAMERA = re.compile(r"camera(0|[1-9][0-9]{0,2})_rgb")
_SOUND = re.compile(r"mic_([0-9]{1,3})")
_WIDTHS = {
    "eef_pos": 3,
    "eef_rot_axis_angle": 3,
    "gripper_width": 1,
    "demo_start_pose": 6,
    "demo_end_pose": 6,
}
_WHOLE = ("eef_pos", "eef_rot_axis_angle")
_ENDS = ("demo_start_pose", "demo_end_pose")
_MOST_SIDE = 65535


@dataclass(slots=True)
class Layout:
    """Streams and the arrays that they come from.

    Attributes
    ----------
    poses : dict of str to dict of str to str
        Stream to its arrays by what they are (``eef_pos`` ... ``demo_end_pose``).
    widths, cameras, tactile, sound : dict of str to str
        Stream to array.
    left_out : dict of str to str
        Arrays that have no place, and why.
    """

    poses: dict[str, dict[str, str]] = field(default_factory=dict)
    widths: dict[str, str] = field(default_factory=dict)
    cameras: dict[str, str] = field(default_factory=dict)
    tactile: dict[str, str] = field(default_factory=dict)
    sound: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def arrays(self) -> list[str]:
        """Names of all arrays that are read."""
        single = (self.widths, self.cameras, self.tactile, self.sound)
        return [
            *(name for parts in self.poses.values() for name in parts.values()),
            *(name for group in single for name in group.values()),
        ]

    def json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)


def is_image(meta: ArrayMeta) -> bool:
    """Whether an array holds images: (N, H, W, 1 or 3) uint8."""
    return (
        meta.dtype.str == "|u1"
        and len(meta.shape) == 4
        and meta.shape[3] in (1, 3)
        and all(1 <= side <= _MOST_SIDE for side in meta.shape[1:3])
    )


def find_layout(arrays: Mapping[str, ArrayMeta], refused: Mapping[str, str]) -> Layout:
    """Assign arrays to streams by their names and shapes.

    One gripper gives ``pose`` and ``width``, several ``pose_robot0`` and so on; one camera gives
    ``rgb``, several ``rgb_camera0`` and so on.

    Parameters
    ----------
    arrays : mapping of str to ArrayMeta
    refused : mapping of str to str
        Arrays that cannot be read, and why.
    """
    layout = Layout(left_out=dict(refused))
    robots: dict[int, dict[str, str]] = {}
    cameras: dict[int, str] = {}
    others: list[str] = []
    for name, meta in arrays.items():
        if match := _ROBOT.fullmatch(name):
            fault = _fault_of_numbers(meta, _WIDTHS[match[2]])
            if fault is None:
                robots.setdefault(int(match[1]), {})[match[2]] = name
        elif match := _CAMERA.fullmatch(name):
            fault = None if is_image(meta) else "it is no (N, H, W, 3) uint8"
            if fault is None:
                cameras[int(match[1])] = name
        elif _SOUND.fullmatch(name):
            fault = _fault_of_sound(meta)
            if fault is None:
                layout.sound[name] = name
        elif is_image(meta):
            fault = None
            others.append(name)
        else:
            fault = "it has no place in an episode"
        if fault is not None:
            layout.left_out[name] = fault
    for number, name in sorted(cameras.items()):
        layout.cameras["rgb" if len(cameras) == 1 else f"rgb_camera{number}"] = name
    _add_robots(layout, robots)
    _add_others(layout, others)
    return layout


def _add_others(layout: Layout, names: Sequence[str]) -> None:
    """Name the streams of other images after their arrays; no two alike."""
    taken = {*layout.cameras, *layout.widths, *layout.poses, *layout.sound}
    for name in names:
        camera = "tactile" not in name
        plain = stream = _stream_name(name, camera)
        number = 1
        # Beside a tactile stream there may come to be one of its differences.
        while taken & {stream, differences_of(stream)}:
            number += 1
            stream = f"{plain}_{number}"
        taken |= {stream} if camera else {stream, differences_of(stream)}
        (layout.cameras if camera else layout.tactile)[stream] = name


def _add_robots(layout: Layout, robots: Mapping[int, dict[str, str]]) -> None:
    for number, parts in sorted(robots.items()):
        suffix = "" if len(robots) == 1 else f"_robot{number}"
        if "gripper_width" in parts:
            layout.widths[f"width{suffix}"] = parts["gripper_width"]
        if all(part in parts for part in _WHOLE):
            layout.poses[f"pose{suffix}"] = {
                part: parts[part] for part in (*_WHOLE, *_ENDS) if part in parts
            }
            continue
        for part in (*_WHOLE, *_ENDS):
            if part in parts:
                layout.left_out[parts[part]] = "position or rotation of that pose is missing"


def _fault_of_numbers(meta: ArrayMeta, width: int) -> str | None:
    flat = width == 1 and len(meta.shape) == 1
    if meta.dtype.kind == "f" and (flat or meta.shape[1:] == (width,)):
        return None
    return f"it is {meta.shape} {meta.dtype}, not (N, {width}) of floating point"


def _fault_of_sound(meta: ArrayMeta) -> str | None:
    if meta.dtype.name in ("int16", "float32", "float64") and len(meta.shape) in (2, 3):
        channels = meta.shape[2] if len(meta.shape) == 3 else 1
        if meta.shape[1] and 1 <= channels <= 64:
            return None
    return f"it is {meta.shape} {meta.dtype}, not (N, samples) of int16 or floating point"


def _stream_name(name: str, camera: bool) -> str:
    plain = re.sub(r"[^a-z0-9_]", "_", name.lower())
    return (f"rgb_{plain}" if camera or not plain[:1].isalpha() else plain)[:50]
