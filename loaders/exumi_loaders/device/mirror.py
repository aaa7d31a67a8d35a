"""Mirror images of whole windows: images, fingers and poses together."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, Self

import torch
from torch import Tensor, nn

from exumi_data.errors import UsageError
from exumi_data.standard import sensors as registered_sensors
from exumi_loaders.device.arms import Arms, arms_of, pose_columns, side_pairs
from exumi_loaders.device.draws import Draws
from exumi_loaders.device.image_module import Batch, image_streams

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset
    from exumi_loaders.tpp import TPPWindows
    from exumi_loaders.windows import Windows

__all__ = ["Mirror", "mirror_relative_poses"]

Axis = Literal["x", "y", "z"]
Flip = Literal["horizontal", "vertical"]

_ALONG = {"horizontal": -1, "vertical": -2}
_REFERENCE = "_reference"


def mirror_relative_poses(poses: Tensor, axis: Axis) -> Tensor:
    """Mirror poses of nine numbers: ``M·T·M``, where M negates one axis.

    Parameters
    ----------
    poses : Tensor
        (..., 9): x y z and the first two rows of the rotation matrix.
    axis : {"x", "y", "z"}

    Returns
    -------
    Tensor
        (..., 9).
    """
    side = torch.ones(3, dtype=poses.dtype, device=poses.device)
    side["xyz".index(axis)] = -1
    return poses * torch.cat((side, side[0] * side, side[1] * side))


class Mirror(nn.Module):
    """Mirror some windows of a batch, as if scene and gripper were seen in a mirror.

    The mirror negates one axis of the gripper: by default x, from the left finger to the right
    one. Then

    - RGB images are flipped; a left and a right camera change places;
    - the streams of the two fingers change places, with their references and their validity, and
      are flipped: the fingers look at each other, so what is right on one is left on the other;
    - poses relative to the gripper become ``M·T·M``; widths stay;
    - two arms change places, with the sensors and cameras that are named by their side.

    All streams of a window are mirrored, or none. The image of a gel that is lit in colours has its
    lights on the wrong sides when it is mirrored, which no sensor produces: such streams are
    refused, unless `any_light` is set.

    Parameters
    ----------
    sensors : mapping of str to str or None
        Registered sensor model of each tactile stream; None is not known. `of` reads them from a
        dataset.
    p : float
        Probability that a window is mirrored.
    axis : {"x", "y", "z"}
        Axis of the pose's child frame that is negated.
    tactile_flip, rgb_flip : {"horizontal", "vertical"}
        How images are flipped. A single image of both fingers side by side, left and right of the
        middle, is flipped horizontally.
    swap : sequence of (str, str), optional
        Image streams that change places; default those whose names differ in ``left`` and
        ``right``. Empty where the axis leads from no finger to another.
    poses : mapping of str to sequence of int
        Tensors that hold poses, and in which column each of the poses (nine numbers) begins;
        default one pose in front of ``action``. `of` reads them from the windows.
    arms : Arms, optional
        How the numbers of several arms change places.
    unchanged : sequence of str
        Tensors of floats that a mirror leaves as they are. Any other is refused, not forgotten.
    any_light : bool
        Mirror images of coloured or unknown light too.
    seed : int

    Raises
    ------
    UsageError
        A sensor is lit in colours, or is not known.
    """

    def __init__(  # noqa: PLR0913  # keyword-only options, each with a default
        self,
        sensors: Mapping[str, str | None],
        *,
        p: float = 0.5,
        axis: Axis = "x",
        tactile_flip: Flip = "horizontal",
        rgb_flip: Flip = "horizontal",
        swap: Sequence[tuple[str, str]] | None = None,
        poses: Mapping[str, Sequence[int]] | None = None,
        arms: Arms | None = None,
        unchanged: Sequence[str] = (),
        any_light: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if not 0 <= p <= 1:
            raise UsageError(f"invalid p ({p}). It must lie between 0 and 1")
        if axis not in ("x", "y", "z"):
            raise UsageError(f"invalid axis ({axis!r}). Supported values are 'x', 'y', 'z'")
        for flip in (tactile_flip, rgb_flip):
            if flip not in _ALONG:
                raise UsageError(
                    f"invalid flip ({flip!r}). Supported values are 'horizontal', 'vertical'"
                )
        if not any_light:
            _refuse_lights(sensors.items())
        self.p = p
        self.axis: Axis = axis
        self.tactile = tuple(sensors)
        self.tactile_flip, self.rgb_flip = tactile_flip, rgb_flip
        self.swap = None if swap is None else tuple(swap)
        self.poses = {"action": (0,)} if poses is None else dict(poses)
        self.arms = arms
        self.unchanged = tuple(unchanged)
        self.draws = Draws(seed)

    @classmethod
    def of(
        cls,
        windows: "Windows",
        *,
        p: float = 0.5,
        any_light: bool = False,
        unchanged: Sequence[str] = (),
        seed: int = 0,
    ) -> Self:
        """Make the mirror of some windows: sensors from their episodes, x from left to right.

        Reads the metadata of every episode. Several grippers change places, by pairs that are
        named ``left`` and ``right``.

        Parameters
        ----------
        windows : TPPWindows or ConcatWindows of them
        p, any_light, unchanged, seed
            As of `Mirror`.

        Raises
        ------
        UsageError
            A sensor is lit in colours, or is not known; of several grippers one has no partner;
            the windows are of another kind.
        """
        parts = _parts(windows)
        # Windows are joined only if their streams and columns are the same.
        layout = parts[0].layout
        models = {found for part in parts for found in _models(part.episodes, layout.tactile)}
        if not any_light:
            _refuse_lights(models)
        begins = pose_columns(layout)
        between = range(0, 9 * max(len(layout.pose) - 1, 0), 9)
        return cls(
            dict(models),
            p=p,
            poses={"action": begins, "proprioception": begins, "between": tuple(between)},
            arms=arms_of(layout, zero=parts[0].steps.zero),
            unchanged=unchanged,
            any_light=any_light,
            seed=seed,
        )

    def extra_repr(self) -> str:
        """Show the settings."""
        return f"p={self.p}, axis={self.axis!r}, tactile={self.tactile}"

    def forward(self, batch: Batch) -> Batch:
        """Mirror some windows of a batch.

        Parameters
        ----------
        batch : dict
            As the loaders give it; it is not changed.

        Returns
        -------
        dict

        Raises
        ------
        UsageError
            Only one of two fingers is there, they differ in size, it is not known what a mirror
            does to some tensor, or frames are JPEG files yet.
        """
        images = image_streams(batch)
        if not images:
            raise UsageError("the batch has no images to mirror")
        chosen = torch.nonzero(self.draws.uniform(len(batch[images[0]]), 0, 1) < self.p)[:, 0]
        partner = self._partners(images)
        changed = {}
        for name, value in batch.items():
            if not isinstance(value, Tensor):
                changed[name] = value
                continue
            source = self._source(batch, name, value, partner)
            flip = self._flip(name, images)
            if flip is not None:
                changed[name] = _replaced(value, chosen, source, flip)
                continue
            mirrored = self._mirrored_poses(name, source)
            changed[name] = value if mirrored is value else _replaced(value, chosen, mirrored)
        return changed

    def _partners(self, images: Sequence[str]) -> dict[str, str]:
        """Return which streams change places."""
        if self.swap is None:
            return side_pairs((*self.tactile, *images))
        return {**dict(self.swap), **{right: left for left, right in self.swap}}

    def _source(self, batch: Batch, name: str, value: Tensor, partner: dict[str, str]) -> Tensor:
        """Return what stands at `name` in the mirror, not flipped yet."""
        stream = max(
            (one for one in partner if name == one or name.startswith(f"{one}_")),
            key=len,
            default=None,
        )
        if stream is None:
            return value if self.arms is None else self.arms.exchanged(batch, name)
        other = partner[stream] + name[len(stream) :]
        found = batch.get(other)
        if not isinstance(found, Tensor) or found.shape != value.shape:
            there = tuple(found.shape) if isinstance(found, Tensor) else "not there"
            raise UsageError(
                f"{name!r} of {tuple(value.shape)} has to change places with {other!r}, "
                f"which is {there}"
            )
        return found

    def _flip(self, name: str, images: Iterable[str]) -> int | None:
        """Return the axis along which images of a name are flipped, None for other tensors."""
        stream = name.removesuffix(_REFERENCE)
        if stream not in images:
            return None
        return _ALONG[self.tactile_flip if stream in self.tactile else self.rgb_flip]

    def _mirrored_poses(self, name: str, value: Tensor) -> Tensor:
        if name not in self.poses:
            if value.is_floating_point() and name not in self.unchanged:
                raise UsageError(
                    f"it is not known what a mirror does to {name!r}",
                    fix="Name it in `poses`, with the columns in which its poses begin, or in "
                    "`unchanged`.",
                )
            return value
        mirrored = value.clone()
        for column in self.poses[name]:
            block = value[..., column : column + 9]
            mirrored[..., column : column + 9] = mirror_relative_poses(block, self.axis)
        return mirrored


def _replaced(value: Tensor, chosen: Tensor, source: Tensor, flip: int | None = None) -> Tensor:
    """Return `value` with the chosen windows of `source` in place of its own."""
    rows = chosen.to(value.device)
    taken = source[rows]
    out = value.clone()
    out[rows] = taken if flip is None else taken.flip(flip)
    return out


def _parts(windows: "Windows") -> tuple["TPPWindows", ...]:
    """Return the windows of each dataset."""
    # Both import the modules of this package.
    from exumi_loaders.concat import ConcatWindows
    from exumi_loaders.tpp import TPPWindows

    if isinstance(windows, ConcatWindows):
        return tuple(one for part in windows.parts for one in _parts(part))
    if isinstance(windows, TPPWindows):
        return (windows,)
    raise UsageError(
        f"it is not known what a mirror does to {type(windows).__name__}",
        fix="Name sensors and poses yourself: Mirror({...}, poses={...}).",
    )


def _models(dataset: "Dataset", streams: Sequence[str]) -> set[tuple[str, str | None]]:
    """Find the sensor models of streams in all episodes of a dataset."""
    found = set()
    for episode in dataset:
        for name in streams:
            sensor = episode[name].metadata.sensor
            found.add((name, None if sensor is None else sensor.model))
    return found


def _refuse_lights(models: Iterable[tuple[str, str | None]]) -> None:
    """Refuse sensors that are lit in colours or not known.

    Raises
    ------
    UsageError
    """
    known = registered_sensors()
    for stream, model in sorted(models, key=str):
        light = known[model].light if model is not None and model in known else None
        if light == "white":
            continue
        if model is None:
            why = "it is not said which sensor they are from, and so not how its gel is lit"
        elif light is None:
            why = f"it is not registered how the gel of {model!r} is lit"
        else:
            why = (
                f"the gel of {model!r} is lit in colours from several sides; mirrored, its lights "
                "are where no sensor has them"
            )
        raise UsageError(
            f"images are not mirrored: {why}",
            where=stream,
            fix="Leave Mirror out, or allow it with any_light=True.",
        )
