"""What a policy sees and does, as a document: recorded windows and live streams both keep to it."""

from collections.abc import Collection
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from exumi_data.episode import Episode
from exumi_data.errors import UsageError
from exumi_data.model import EpisodeMetadata, PoseStream
from exumi_data.model.base import Identifier, Model, Rational, Sha256, StreamName, Version
from exumi_data.model.streams import images_of
from exumi_loaders.actions import action_columns, between_columns
from exumi_loaders.buffers import ItemSpec
from exumi_loaders.calibration import calibration_digest, calibration_items
from exumi_loaders.documents import read_document, write_beside
from exumi_loaders.layout import Layout

__all__ = ["POLICY_SPEC_FORMAT", "PolicySpec", "PolicyStreamSpec", "check_rig"]

POLICY_SPEC_FORMAT = "exumi-policy-spec"

_NS = Annotated[int, Field(ge=0, le=60_000_000_000)]


class PolicyStreamSpec(Model):
    """What a policy takes one stream to be."""

    model_config = ConfigDict(frozen=True)

    kind: Literal["tactile", "rgb", "pose", "width"]
    latency_ns: _NS
    """How long after its capture a sample is at hand."""
    stale_ns: _NS
    """How much older than that a sample may be."""
    height: Annotated[int, Field(ge=1)] | None = None
    width: Annotated[int, Field(ge=1)] | None = None
    channels: Literal[1, 3] | None = None
    """As stored."""
    grey: bool = False
    """Whether the policy is given luma of frames that are stored in colour."""
    reference: bool = False
    """Whether it is given the image without contact."""
    parents: tuple[Identifier, ...] = ()
    """Parent frames of a pose stream."""
    child: Identifier | None = None
    """Child frame of a pose stream: relative actions are in it."""
    calibrations: tuple[Sha256 | Literal[""], ...] = ()
    """Digests of its calibration, of all rigs that recorded it; empty: none is stated."""

    @model_validator(mode="after")
    def _images_have_a_size(self) -> "PolicyStreamSpec":
        size = (self.height, self.width, self.channels)
        if (self.kind in ("tactile", "rgb")) != all(size):
            msg = f"a stream of kind {self.kind} with frames of {size}"
            raise ValueError(msg)
        return self

    @property
    def shape(self) -> tuple[int, int, int]:
        """(H, W, C) of a frame as it is stored."""
        if self.height is None or self.width is None or self.channels is None:
            raise UsageError(f"a stream of kind {self.kind} has no frames")
        return self.height, self.width, self.channels

    @property
    def given(self) -> tuple[int, int, int]:
        """(H, W, C) of a frame as the policy is given it."""
        height, width, channels = self.shape
        return height, width, 1 if self.grey else channels


class PolicySpec(Model):
    """What a policy sees and does: made by `PolicyWindows`, needed by `PolicyStream`.

    It cannot be changed, and is kept as JSON with the weights that were trained on it.
    """

    model_config = ConfigDict(frozen=True)

    format: Literal["exumi-policy-spec"] = "exumi-policy-spec"
    version: Version = "1.0"
    tick_s: Rational
    """Distance of two ticks, seconds."""
    observation_steps: tuple[Annotated[int, Field(le=0, ge=-100_000)], ...]
    """Ticks of the observations around the current one, ascending; the last is 0."""
    action_steps: tuple[Annotated[int, Field(ge=0, le=100_000)], ...]
    """Ticks of the actions after the current one, ascending."""
    action: Literal["relative", "absolute"]
    """Whether poses are relative to the one that is at hand, or in their parent frame."""
    proprioception: bool
    tactile: tuple[StreamName, ...]
    rgb: tuple[StreamName, ...]
    pose: tuple[StreamName, ...]
    width: tuple[StreamName, ...]
    streams: dict[StreamName, PolicyStreamSpec]
    dataset: Sha256
    """Digest of the episodes that the windows are of."""
    split: str | None = None
    """The split and list that these episodes are."""

    @model_validator(mode="after")
    def _is_consistent(self) -> "PolicySpec":
        kinds = ("tactile", "rgb", "pose", "width")
        named = [(name, kind) for kind in kinds for name in getattr(self, kind)]
        if sorted(named) != sorted((name, stream.kind) for name, stream in self.streams.items()):
            msg = "the streams are not those that are named by kind"
            raise ValueError(msg)
        for name in ("observation_steps", "action_steps"):
            steps = getattr(self, name)
            if not steps or list(steps) != sorted(set(steps)):
                msg = f"{name} are not ascending"
                raise ValueError(msg)
        if self.observation_steps[-1] != 0:
            msg = "the last observation is not at step 0"
            raise ValueError(msg)
        return self

    @property
    def tick(self) -> Fraction:
        """Distance of two ticks, seconds."""
        return Fraction(self.tick_s)

    @property
    def layout(self) -> Layout:
        """The streams, and which of them are one gripper."""
        return Layout(self.tactile, self.rgb, self.pose, self.width)

    @property
    def action_columns(self) -> tuple[str, ...]:
        """Name of each column of ``action`` and ``proprioception``."""
        return action_columns(self.layout)

    @property
    def between_columns(self) -> tuple[str, ...]:
        """Name of each column of ``between``."""
        return between_columns(self.layout)

    @property
    def observation(self) -> dict[str, ItemSpec]:
        """Shape and type of each key of an observation."""
        steps = len(self.observation_steps)
        spec: dict[str, ItemSpec] = {}
        for name in self.tactile + self.rgb:
            stream = self.streams[name]
            spec[name] = ItemSpec((steps, *stream.given), "uint8", image=True)
            spec[f"{name}_valid"] = ItemSpec((steps,), "bool")
            if stream.reference:
                spec[f"{name}_reference"] = ItemSpec(stream.given, "uint8", image=True)
        motion = {}
        if self.proprioception:
            motion["proprioception"] = len(self.action_columns)
        if self.proprioception and len(self.pose) > 1:
            motion["between"] = len(self.between_columns)
        for name, columns in motion.items():
            spec[name] = ItemSpec((steps, columns), "float32")
            spec[f"{name}_valid"] = ItemSpec((steps,), "bool")
        spec["observation_padding"] = ItemSpec((steps,), "bool")
        return spec

    @property
    def motion(self) -> dict[str, Any]:
        """What decides the meaning of actions and proprioception; numbers of two are comparable
        where it is the same.
        """  # noqa: D205  # one sentence
        low = self.pose + self.width
        return {
            "tick_s": self.tick_s,
            "observation_steps": self.observation_steps,
            "action_steps": self.action_steps,
            "action": self.action,
            "columns": self.action_columns,
            "latency_ns": {name: self.streams[name].latency_ns for name in low},
            "child frames": {name: self.streams[name].child for name in self.pose},
        }

    def save(self, path: Path | str) -> None:
        """Write it as JSON.

        Parameters
        ----------
        path : path
            Not within a dataset.
        """
        write_beside(self, Path(path))

    @classmethod
    def load(cls, path: Path | str) -> "PolicySpec":
        """Read what `save` has written.

        Parameters
        ----------
        path : path

        Raises
        ------
        MetadataError
        """
        return read_document(cls, Path(path), POLICY_SPEC_FORMAT)


def check_rig(
    spec: PolicySpec, rig: Episode | EpisodeMetadata, accept: Collection[str] = ()
) -> None:
    """Refuse a rig whose streams are not what a policy takes them to be.

    Parameters
    ----------
    spec : PolicySpec
    rig : Episode or EpisodeMetadata
        The rig as it describes the episodes that it records.
    accept : collection of str
        Streams whose calibration may be another.

    Raises
    ------
    UsageError
        Names the stream, what it is, and what it should be.
    """
    metadata = rig.metadata if isinstance(rig, Episode) else rig
    unknown = set(accept) - set(spec.streams)
    if unknown:
        raise UsageError(f"accept names {', '.join(sorted(unknown))}, which the policy has not")
    for name, stream in spec.streams.items():
        model = metadata.streams.get(name)
        if model is None or model.kind != stream.kind:
            kinds = ", ".join(f"{other} ({m.kind})" for other, m in metadata.streams.items())
            raise UsageError(
                f"the policy needs a {stream.kind} stream {name!r}",
                fix=f"The rig has {kinds or 'no streams'}.",
            )
        images = images_of(model)
        if images is not None:
            size = (images.height, images.width, images.channels)
            _check(name, "frames (height, width, channels)", size, (stream.shape,))
        if isinstance(model, PoseStream):
            _check(name, "child frame (tool frame)", model.frames.child, (stream.child,))
            if spec.action == "absolute":
                _check(name, "parent frame", model.frames.parent, stream.parents)
        if name not in accept and stream.calibrations:
            _check_calibration(rig, metadata, name, stream.calibrations)


def _check(stream: str, what: str, found: object, expected: Collection[object]) -> None:
    if found not in expected:
        raise UsageError(
            f"{what} of {stream}: the rig has {found!r}, the policy was trained on "
            f"{' or '.join(map(repr, expected))}",
            fix="Make the rig's streams what the dataset's are (exumi prepare says how frames were "
            "made), or train on data of this rig.",
        )


def _check_calibration(
    rig: Episode | EpisodeMetadata, metadata: EpisodeMetadata, name: str, known: tuple[str, ...]
) -> None:
    if calibration_digest(rig, name) in known:
        return
    items = ", ".join(calibration_items(metadata, name)) or "none is stated"
    raise UsageError(
        f"the calibration of {name} ({items}) is none of the {len(known)} that the policy was "
        "trained on",
        fix=f"Calibrate the rig to the same values, or accept the difference: accept=({name!r},).",
    )
