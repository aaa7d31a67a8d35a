"""Which streams windows are made of, and which of them belong to one gripper."""

from dataclasses import dataclass, field
from typing import NamedTuple

from exumi_data.dataset import Dataset
from exumi_data.errors import UsageError

__all__ = ["Gripper", "Layout", "Names", "choose_layout"]

Names = str | tuple[str, ...] | list[str] | None
"""Streams of one kind: a name, several in the wanted order, or None for all there are."""


class Gripper(NamedTuple):
    """A pose stream and a width stream that belong together; one of them may be missing."""

    pose: str | None
    width: str | None


@dataclass(frozen=True)
class Layout:
    """Which streams windows are made of, and how they look: the same in all episodes.

    Attributes
    ----------
    tactile, rgb : tuple of str
        Image streams.
    pose, width : tuple of str
        Streams of poses and gripper widths.
    shapes : dict of str to tuple
        (H, W, C) of each image stream.
    references : dict of str to bool
        Whether each tactile stream has a reference image in all episodes.
    children : dict of str to str
        The child frame of each pose stream: relative actions are in it.
    parents : dict of str to dict of str to str
        Of each pose stream every parent frame that it has, and the first episode that has it.
    calibrations : dict of str to dict of str to str
        Of each pose and image stream every digest of its calibration (`calibration_digest`), and
        the first episode that has it. Poses whose digests differ may have other tool frames.
    common_parent : bool
        Whether all pose streams of an episode have the same parent frame, in every episode.
    """

    tactile: tuple[str, ...]
    rgb: tuple[str, ...]
    pose: tuple[str, ...] = ()
    width: tuple[str, ...] = ()
    shapes: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    references: dict[str, bool] = field(default_factory=dict)
    children: dict[str, str] = field(default_factory=dict)
    parents: dict[str, dict[str, str]] = field(default_factory=dict)
    calibrations: dict[str, dict[str, str]] = field(default_factory=dict)
    common_parent: bool = True

    @property
    def images(self) -> tuple[str, ...]:
        """All image streams."""
        return self.tactile + self.rgb

    @property
    def low(self) -> tuple[str, ...]:
        """All pose and width streams."""
        return self.pose + self.width

    @property
    def streams(self) -> tuple[str, ...]:
        """All streams."""
        return self.images + self.low

    @property
    def grippers(self) -> tuple[Gripper, ...]:
        """The grippers, in the order of their poses.

        A width belongs to the pose whose name is the same but for the kind (``pose_left`` and
        ``width_left``). What is left over is joined in order if there are as many poses as
        widths; otherwise each is a gripper of its own, and those without a pose come last.
        """
        widths = {_side(name, "width"): name for name in reversed(self.width)}
        matched = {name: widths.pop(_side(name, "pose"), None) for name in self.pose}
        lonely = [name for name, width in matched.items() if width is None]
        rest = [name for name in self.width if name not in matched.values()]
        if len(lonely) == len(rest):
            matched |= dict(zip(lonely, rest, strict=True))
            rest = []
        pairs = [Gripper(pose, width) for pose, width in matched.items()]
        return (*pairs, *(Gripper(None, width) for width in rest))


def _side(name: str, kind: str) -> tuple[str, ...]:
    """Return what a stream's name says apart from its kind: ``pose_left`` says ``left``."""
    return tuple(word for word in name.split("_") if word != kind)


def choose_layout(
    dataset: Dataset,
    *,
    tactile: Names = None,
    rgb: Names = None,
    pose: Names = None,
    width: Names = None,
) -> Layout:
    """Choose the streams: those named, or all of their kind; of poses those of hands.

    A recorder may add the headset's own pose. So where streams are called ``pose`` or ``pose_...``,
    other pose streams have to be named to be taken.

    Parameters
    ----------
    dataset : Dataset
    tactile, rgb, pose, width : str or sequence of str, optional
        Names, in the wanted order; default all of the kind (poses: of hands), sorted. An empty
        sequence takes none.

    Returns
    -------
    Layout
        Without shapes, references and frames: those are in the episodes.

    Raises
    ------
    UsageError
        A stream is missing in some episodes, or there are no images at all.
    """
    if not len(dataset):
        raise UsageError("the selection holds no episodes", where=dataset.path)
    wanted = {"tactile": tactile, "rgb": rgb, "pose": pose, "width": width}
    there: dict[str, dict[str, int]] = {kind: {} for kind in wanted}
    for row in dataset.catalog.column("streams").to_pylist():
        for stream in row:
            if stream["kind"] in there:
                kind = there[stream["kind"]]
                kind[stream["name"]] = kind.get(stream["name"], 0) + 1
    hands = {name: number for name, number in there["pose"].items() if _is_of_a_hand(name)}
    there["pose"] = there["pose"] if pose is not None else hands or there["pose"]
    chosen = {kind: _chosen(dataset, kind, wanted[kind], there[kind]) for kind in wanted}
    layout = Layout(chosen["tactile"], chosen["rgb"], chosen["pose"], chosen["width"])
    if not layout.images:
        raise UsageError("no tactile and no rgb stream to make windows of", where=dataset.path)
    return layout


def _is_of_a_hand(name: str) -> bool:
    return name == "pose" or name.startswith("pose_")


def _chosen(dataset: Dataset, kind: str, names: Names, there: dict[str, int]) -> tuple[str, ...]:
    found = sorted(there) if names is None else (names,) if isinstance(names, str) else names
    for name in found:
        if there.get(name, 0) != len(dataset):
            raise UsageError(
                f"{there.get(name, 0)} of {len(dataset)} episodes have a {kind} stream {name!r}",
                where=dataset.path,
                fix=f"Name the streams to use ({kind}=...), or select episodes that have it: "
                f"dataset.select(stream={name!r}).",
            )
    if len(set(found)) != len(found):
        raise UsageError(f"{kind} names a stream twice: {', '.join(found)}")
    return tuple(found)
