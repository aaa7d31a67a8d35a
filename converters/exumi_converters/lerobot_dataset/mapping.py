"""Which numbers of a dataset are poses, widths and the like: where names or options say so."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from exumi_converters.lerobot_dataset.documents import Info
from exumi_converters.lerobot_dataset.layout import (
    ACTION,
    ACTIVITY,
    DEFAULT_FEATURES,
    IMAGES,
    POSE_PARTS,
    WIDTH_PART,
    Declaration,
    DeclaredStream,
)
from exumi_converters.lerobot_dataset.options import LeRobotReadOptions, listed
from exumi_converters.names import free_stream_name
from exumi_data.errors import UsageError
from exumi_data.geometry import axis_angle_to_quaternion, make_sign_continuous

__all__ = ["FeatureMap", "ImageStream", "NumberStream", "map_features", "stream_values"]

Order = Literal["xyzw", "wxyz", "rotvec", "values"]
_PARTS = {"xyzw": 7, "wxyz": 7, "rotvec": 6}
_PART = re.compile(r"(?:(?P<prefix>.+)[./_])?(?P<part>width_m|qx|qy|qz|qw|x|y|z)")
_LEAST_NORM = 0.5


@dataclass(frozen=True, slots=True)
class NumberStream:
    """A stream that some columns of a feature become.

    Attributes
    ----------
    name, kind, feature : str
    columns : tuple of int
    order : {"xyzw", "wxyz", "rotvec", "values"}
        How a pose's rotation is written; ``values`` for other kinds.
    fields : dict
        What `EpisodeWriter.add_stream` takes.
    """

    name: str
    kind: str
    feature: str
    columns: tuple[int, ...]
    order: Order = "values"
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ImageStream:
    """A stream that an image feature becomes."""

    name: str
    kind: Literal["rgb", "tactile"]
    feature: str
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FeatureMap:
    """What a dataset's features become.

    Attributes
    ----------
    images : tuple of ImageStream
    numbers : tuple of NumberStream
    unread : dict of str to str
        What is not read, and why.
    """

    images: tuple[ImageStream, ...]
    numbers: tuple[NumberStream, ...]
    unread: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "FeatureMap":
        """Take up what `as_json` returned."""
        return cls(
            images=tuple(ImageStream(**image) for image in values["images"]),
            numbers=tuple(
                NumberStream(**{**stream, "columns": tuple(stream["columns"])})
                for stream in values["numbers"]
            ),
            unread=dict(values["unread"]),
        )


def map_features(
    info: Info, declaration: Declaration | None, told: LeRobotReadOptions
) -> FeatureMap:
    """Decide what each feature becomes.

    Parameters
    ----------
    info : Info
    declaration : Declaration, optional
        What our exporter said of the features.
    told : LeRobotReadOptions

    Raises
    ------
    UsageError
        An option names what is not there.
    """
    mapper = _Mapper(info, dict(declaration.streams) if declaration else {}, told)
    mapper.map_images()
    mapper.map_told()
    mapper.map_declared()
    mapper.map_named()
    mapper.name_the_rest(ours=declaration is not None)
    return FeatureMap(tuple(mapper.images), tuple(mapper.numbers), mapper.unread)


class _Mapper:
    def __init__(
        self, info: Info, declared: dict[str, DeclaredStream], told: LeRobotReadOptions
    ) -> None:
        self._info = info
        self._declared = declared
        self._told = told
        self._taken: dict[str, set[int]] = {}
        self._names: set[str] = set()
        self._frames = _frames(told.frames)
        self.images: list[ImageStream] = []
        self.numbers: list[NumberStream] = []
        self.unread: dict[str, str] = {}

    def _free(self, wanted: str) -> str:
        """Make a stream's name that is not taken yet."""
        free = free_stream_name(wanted, self._names)
        self._names.add(free)
        return free

    def map_images(self) -> None:
        tactile = listed(self._told.tactile)
        there = self._info.of_images()
        for name in tactile:
            if name not in there:
                raise UsageError(
                    f"Invalid tactile ({name}): no such image feature",
                    fix=f"There are: {', '.join(there) or 'none'}.",
                )
        declared = {said.feature: (name, said) for name, said in self._declared.items()}
        for key, feature in there.items():
            if feature.is_depth:
                self.unread[key] = "distances that are coded as colours"
                continue
            own, said = declared.get(key, (None, None))
            kind: Literal["rgb", "tactile"] = "tactile" if key in tactile else "rgb"
            fields: dict[str, Any] = {}
            if said is not None and said.kind in {"rgb", "tactile"}:
                kind = "tactile" if said.kind == "tactile" or key in tactile else "rgb"
                fields = said.fields()
            name = self._free(own or key.removeprefix(IMAGES).removeprefix("observation."))
            self.images.append(ImageStream(name, kind, key, fields))

    def map_told(self) -> None:
        for text in listed(self._told.pose):
            feature, first, order = _told_pose(text)
            columns = self._columns(feature, first, _PARTS[order], f"pose ({text})")
            self._add_pose("pose", feature, columns, order, {})
        for text in listed(self._told.width):
            feature, _, column = text.rpartition(":")
            columns = self._columns(feature, column, 1, f"width ({text})")
            self._add(NumberStream(self._free("width"), "width", feature, columns))

    def _columns(self, feature: str, first: str, count: int, option: str) -> tuple[int, ...]:
        there = self._vectors()
        width = there.get(feature, 0)
        if not first.isdecimal() or int(first) + count > width:
            said = ", ".join(f"{key} of {n}" for key, n in there.items())
            raise UsageError(
                f"Invalid {option}: {count} column(s) of a feature are needed",
                fix=f"There are: {said or 'none'}; columns count from 0.",
            )
        return tuple(range(int(first), int(first) + count))

    def _vectors(self) -> dict[str, int]:
        """Return the features of numbers, with how many they have."""
        return {
            key: feature.shape[0]
            for key, feature in self._info.features.items()
            if not feature.is_image
            and key not in DEFAULT_FEATURES
            and len(feature.shape) == 1
            and feature.dtype in {"float32", "float64"}
        }

    def map_declared(self) -> None:
        """Take up what our exporter said of wrenches and taxels, which no names would tell."""
        for name, said in self._declared.items():
            if said.kind not in {"wrench", "taxels"} or said.feature not in self._vectors():
                continue
            labels = self._info.features[said.feature].labels() or []
            columns = [i for i, label in enumerate(labels) if label.startswith(f"{name}.")]
            grid = said.grid or [len(said.components or ())]
            if len(columns) == int(np.prod(grid)) and self._is_free(said.feature, columns):
                stream = NumberStream(
                    self._free(name), said.kind, said.feature, tuple(columns), fields=said.fields()
                )
                self._add(stream)

    def map_named(self) -> None:
        """Take up columns whose names say that they are a pose or a width."""
        for feature in self._vectors():
            if feature.startswith(ACTION):
                continue  # what was commanded is no measurement
            labels = self._info.features[feature].labels() or []
            for prefix, parts in _grouped(labels).items():
                self._map_group(feature, prefix, parts)

    def _map_group(self, feature: str, prefix: str, parts: dict[str, int]) -> None:
        said = self._declared.get(prefix)
        fields = said.fields() if said is not None and said.feature == feature else {}
        if all(part in parts for part in POSE_PARTS):
            columns = tuple(parts[part] for part in POSE_PARTS)
            if self._is_free(feature, columns):
                self._add_pose(prefix or "pose", feature, columns, "xyzw", fields)
        if WIDTH_PART in parts and self._is_free(feature, [parts[WIDTH_PART]]):
            name = self._free(prefix or "width")
            columns = (parts[WIDTH_PART],)
            self._add(NumberStream(name, "width", feature, columns, fields=fields))

    def _add_pose(
        self,
        name: str,
        feature: str,
        columns: tuple[int, ...],
        order: Order,
        fields: dict[str, Any],
    ) -> None:
        said = {"frames": self._frames, **fields}
        self._add(NumberStream(self._free(name), "pose", feature, columns, order, said))

    def _is_free(self, feature: str, columns: Sequence[int]) -> bool:
        return not self._taken.get(feature, set()) & set(columns)

    def _add(self, stream: NumberStream) -> None:
        self._taken.setdefault(stream.feature, set()).update(stream.columns)
        self.numbers.append(stream)

    def name_the_rest(self, *, ours: bool) -> None:
        """Say what is not read."""
        for key, feature in self._info.features.items():
            if feature.is_image or key in DEFAULT_FEATURES:
                continue
            if key.startswith(ACTION):
                self.unread[key] = "actions are no measurements"
            elif ours and key == ACTIVITY:
                self.unread[key] = "it is computed anew"
            elif key not in self._vectors():
                self.unread[key] = f"{feature.dtype} of {feature.shape}"
            else:
                self._name_columns(key, feature.labels(), feature.shape[0])

    def _name_columns(self, key: str, labels: list[str] | None, count: int) -> None:
        left = [i for i in range(count) if i not in self._taken.get(key, set())]
        if left:
            named = ", ".join(labels[i] if labels else str(i) for i in left[:12])
            more = ", ..." if len(left) > 12 else ""
            self.unread[key] = f"nothing says what they are: {named}{more}"


def _grouped(labels: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return prefix, part and column of the names that are a pose's or a width's."""
    found: dict[str, dict[str, int]] = {}
    twice = set()
    for column, label in enumerate(labels):
        match = _PART.fullmatch(label.lower())
        if match is not None:
            group = found.setdefault(match["prefix"] or "", {})
            if match["part"] in group:
                twice.add(match["prefix"] or "")
            group[match["part"]] = column
    # Of two x that are called the same, nothing says which is whose.
    return {prefix: parts for prefix, parts in found.items() if prefix not in twice}


def _frames(text: str) -> dict[str, str]:
    if not text:
        return {"parent": "unknown", "child": "unknown"}
    parent, _, child = text.partition("/")
    if not parent.strip() or not child.strip():
        raise UsageError(f"Invalid frames ({text}): write them as <parent>/<child>")
    return {"parent": parent.strip(), "child": child.strip()}


def _told_pose(text: str) -> tuple[str, str, Order]:
    feature, first, order = (*text.rsplit(":", 2), "", "")[:3]
    if order not in _PARTS:
        raise UsageError(
            f"Invalid pose ({text}): write <feature>:<first column>:<order>",
            fix=f"Orders are {', '.join(_PARTS)}.",
        )
    return feature, first, order  # type: ignore[return-value]  # one of the keys


def stream_values(stream: NumberStream, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a stream's values, and which of them can be: finite, and of a rotation.

    Parameters
    ----------
    stream : NumberStream
    numbers : (N, C)
        The feature.

    Returns
    -------
    values : (N, ...) float64
        Of those that can be.
    usable : (N,) bool
    """
    values = numbers[:, list(stream.columns)].astype(np.float64)
    usable = np.asarray(np.isfinite(values).all(axis=1))
    if stream.kind == "width":
        return values[usable, 0], usable
    if stream.kind == "taxels":
        return values[usable].reshape(-1, *stream.fields["grid"]), usable
    if stream.kind != "pose":
        return values[usable], usable
    if stream.order == "rotvec":
        rotation = make_sign_continuous(axis_angle_to_quaternion(values[usable, 3:]))
        return np.concatenate((values[usable, :3], rotation), axis=1), usable
    if stream.order == "wxyz":
        values = values[:, [0, 1, 2, 4, 5, 6, 3]]
    norm = np.linalg.norm(np.where(usable[:, None], values[:, 3:], 0.0), axis=1)
    usable = usable & (norm > _LEAST_NORM)
    values[usable, 3:] /= norm[usable, None]
    return values[usable], usable
