"""Which features the streams of a dataset become, decided once for all episodes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from exumi_converters.lerobot_dataset.layout import (
    ACTION,
    ACTIVITY,
    DEFAULT_FEATURES,
    IMAGES,
    POSE_PARTS,
    STATE,
    WIDTH_PART,
    DeclaredStream,
)
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UsageError
from exumi_data.model.streams import images_of

__all__ = ["KINDS", "Features", "ImageFeature", "Profile", "VectorFeature", "choose", "profile_of"]

KINDS = ("rgb", "tactile", "pose", "width", "wrench", "taxels")
_VECTORS = {
    "pose": STATE,
    "width": STATE,
    "wrench": "observation.wrench",
    "taxels": "observation.taxels",
}


@dataclass(frozen=True, slots=True)
class ImageFeature:
    """A video: what one image stream becomes."""

    stream: str
    key: str
    height: int
    width: int


@dataclass(frozen=True, slots=True)
class VectorFeature:
    """Numbers of one or several streams, one after the other."""

    key: str
    streams: tuple[str, ...]
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Features:
    """All features but those that every dataset has.

    Attributes
    ----------
    images : tuple of ImageFeature
    vectors : tuple of VectorFeature
        The state first, if there is one.
    activity : tuple of str
        Tactile streams whose activity is written.
    """

    images: tuple[ImageFeature, ...] = ()
    vectors: tuple[VectorFeature, ...] = ()
    activity: tuple[str, ...] = ()

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of the streams that are written."""
        named = [image.stream for image in self.images]
        return (*named, *(name for vector in self.vectors for name in vector.streams))

    @property
    def state(self) -> VectorFeature | None:
        """The feature ``observation.state``."""
        return next((vector for vector in self.vectors if vector.key == STATE), None)

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "Features":
        """Take up what `as_json` returned."""
        return cls(
            images=tuple(ImageFeature(**image) for image in values["images"]),
            vectors=tuple(
                VectorFeature(vector["key"], tuple(vector["streams"]), tuple(vector["names"]))
                for vector in values["vectors"]
            ),
            activity=tuple(values["activity"]),
        )

    def document(self, *, action: bool, video: dict[str, Any]) -> dict[str, Any]:
        """Return the part ``features`` of ``info.json``.

        Parameters
        ----------
        action : bool
            Whether there is an action, of the state's names.
        video : dict
            What is said of every video, beside its size.
        """
        found: dict[str, Any] = {}
        for vector in self.vectors:
            found[vector.key] = _vector("float32", vector.names)
        if action and self.state is not None:
            found[ACTION] = _vector("float32", self.state.names)
        if self.activity:
            found[ACTIVITY] = _vector("float32", self.activity)
        for image in self.images:
            found[image.key] = {
                "dtype": "video",
                "shape": [image.height, image.width, 3],
                "names": ["height", "width", "channels"],
                "info": {"video.height": image.height, "video.width": image.width, **video},
            }
        for name, dtype in DEFAULT_FEATURES.items():
            found[name] = {"dtype": dtype, "shape": [1], "names": None}
        return found


def _vector(dtype: str, names: Sequence[str]) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [len(names)], "names": list(names)}


@dataclass(frozen=True, slots=True)
class Profile:
    """What is asked of an episode before anything is read of it.

    Attributes
    ----------
    id : str
    shapes : dict of str to tuple
        What has to be the same in all episodes, for each stream that can be written.
    declared : dict of str to DeclaredStream
        What is said of each of them.
    rates : dict of str to str or None
        Nominal rates.
    activity : frozenset of str
        Streams whose activity is there.
    others : dict of str to str
        Streams that cannot be written, with their kinds.
    robot, licence, regime : str
    """

    id: str
    shapes: dict[str, tuple[Any, ...]]
    declared: dict[str, DeclaredStream]
    rates: dict[str, str | None]
    activity: frozenset[str]
    others: dict[str, str]
    robot: str | None
    licence: str
    regime: str

    def fault(self, shapes: dict[str, tuple[Any, ...]]) -> str | None:
        """Return why it does not have the streams that are written."""
        for name, wanted in shapes.items():
            if name not in self.shapes:
                return f"it has no stream {name!r} that can be written"
            if self.shapes[name] != wanted:
                return (
                    f"its {name} is {_said(self.shapes[name])}, that of the others {_said(wanted)}"
                )
        return None


def _said(shape: tuple[Any, ...]) -> str:
    return " ".join("×".join(map(str, p)) if isinstance(p, tuple) else str(p) for p in shape)


def profile_of(episode: Episode) -> Profile:
    """Look at the metadata of an episode."""
    metadata = episode.metadata
    streams = {name: s for name, s in episode.streams.items() if s.kind in KINDS}
    derived = episode.derived.items if episode.derived else {}
    robot = metadata.device or metadata.embodiment
    return Profile(
        id=episode.id,
        shapes={name: _shape(stream) for name, stream in streams.items()},
        declared={n: DeclaredStream.of(_feature_of(s), s.metadata) for n, s in streams.items()},
        rates={name: stream.metadata.nominal_rate for name, stream in streams.items()},
        activity=frozenset(name for name in streams if f"{name}/activity" in derived),
        others={n: s.kind for n, s in episode.streams.items() if s.kind not in KINDS},
        robot=None if robot is None else robot.name,
        licence=metadata.licence,
        regime=metadata.regime,
    )


def _feature_of(stream: StreamView) -> str:
    return f"{IMAGES}{stream.name}" if stream.is_image else _VECTORS[stream.kind]


def _shape(stream: StreamView) -> tuple[Any, ...]:
    """Return what LeRobot needs to be the same everywhere."""
    model: Any = stream.metadata
    images = images_of(model)
    if images is not None:
        return (stream.kind, (images.height, images.width))
    if stream.kind == "pose":
        return (stream.kind, f"{model.frames.parent}→{model.frames.child}")
    if stream.kind == "wrench":
        return (stream.kind, tuple(model.components))
    return (stream.kind, tuple(model.grid)) if stream.kind == "taxels" else (stream.kind,)


def choose(profiles: Sequence[Profile], wanted: Sequence[str]) -> dict[str, tuple[Any, ...]]:
    """Choose the streams that are written, each with the shape that most episodes give it.

    Parameters
    ----------
    profiles : sequence of Profile
    wanted : sequence of str
        Names that the user gave; none: those that all episodes have.

    Raises
    ------
    UsageError
        There is none.
    """
    there = {name for profile in profiles for name in profile.shapes}
    unknown = [name for name in wanted if name not in there]
    if unknown:
        raise UsageError(
            f"no stream {unknown[0]!r} that can be written",
            fix=f"There are: {', '.join(sorted(there)) or 'none'}.",
        )
    names = wanted or [n for n in profiles[0].shapes if all(n in p.shapes for p in profiles)]
    if not names:
        raise UsageError(
            f"the episodes have no stream of {', '.join(KINDS)} in common",
            fix="Name those to write with -o streams=; episodes without them are left out.",
        )
    shapes = {}
    for name in names:
        counted = Counter(p.shapes[name] for p in profiles if name in p.shapes)
        shapes[name] = counted.most_common(1)[0][0]
    return shapes


def make_features(shapes: dict[str, tuple[Any, ...]], profiles: Sequence[Profile]) -> Features:
    """Return the features that streams become.

    Parameters
    ----------
    shapes : dict of str to tuple
        As `choose` returned them.
    profiles : sequence of Profile
        Of the episodes that are written.
    """
    images, grouped, activity = [], _Grouped(), []
    for name, shape in shapes.items():
        kind = shape[0]
        if kind in {"rgb", "tactile"}:
            images.append(ImageFeature(name, f"{IMAGES}{name}", *shape[1]))
            if kind == "tactile" and all(name in profile.activity for profile in profiles):
                activity.append(name)
        else:
            grouped.add(_VECTORS[kind], name, _names(name, shape))
    return Features(tuple(images), grouped.vectors(), tuple(activity))


@dataclass(slots=True)
class _Grouped:
    streams: dict[str, list[str]] = field(default_factory=dict)
    names: dict[str, list[str]] = field(default_factory=dict)

    def add(self, key: str, stream: str, names: Sequence[str]) -> None:
        self.streams.setdefault(key, []).append(stream)
        self.names.setdefault(key, []).extend(names)

    def vectors(self) -> tuple[VectorFeature, ...]:
        keys = [key for key in dict.fromkeys(_VECTORS.values()) if key in self.streams]
        return tuple(
            VectorFeature(key, tuple(self.streams[key]), tuple(self.names[key])) for key in keys
        )


def _names(stream: str, shape: tuple[Any, ...]) -> list[str]:
    parts: Sequence[str] = (WIDTH_PART,)
    if shape[0] == "pose":
        parts = POSE_PARTS
    elif shape[0] == "wrench":
        parts = shape[1]
    elif shape[0] == "taxels":
        rows, columns = shape[1]
        parts = [f"{row}.{column}" for row in range(rows) for column in range(columns)]
    return [f"{stream}.{part}" for part in parts]
