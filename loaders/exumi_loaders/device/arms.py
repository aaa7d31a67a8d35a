"""Several arms in a mirror: the left one becomes the right one."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from exumi_data.errors import UsageError
from exumi_loaders.layout import Gripper, Layout

__all__ = ["Arms", "arms_of", "other_side", "pose_columns", "side_pairs"]

_SIDE = re.compile(r"(?<![a-z])(left|right)(?![a-z])")
_OTHER = {"left": "right", "right": "left"}
_NINE = 9  # numbers of a pose


def other_side(name: str) -> str:
    """Name what is on the other side: ``pose_left`` of ``pose_right``, and the other way round.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
        The same name where it says no side.
    """
    return _SIDE.sub(lambda side: _OTHER[side[0]], name)


def side_pairs(names: Iterable[str]) -> dict[str, str]:
    """Pair names that differ in left and right.

    Parameters
    ----------
    names : iterable of str

    Returns
    -------
    dict of str to str
        The partner of each name that has one.
    """
    there = set(names)
    pairs = {name: other_side(name) for name in sorted(there)}
    return {name: other for name, other in pairs.items() if other != name and other in there}


@dataclass(frozen=True)
class Arms:
    """How the numbers of several arms change places.

    Attributes
    ----------
    columns : tuple of int
        From which column each column of ``action`` and ``proprioception`` is taken.
    poses : tuple of int
        At which column of ``action`` each pose begins; the others are seen from the first.
    partner : tuple of int
        With which pose each of them changes places.
    zero : int
        Position of step 0 among the steps.
    """

    columns: tuple[int, ...]
    poses: tuple[int, ...]
    partner: tuple[int, ...]
    zero: int

    def exchanged(self, batch: dict[str, Tensor], name: str) -> Tensor:
        """Return a tensor with the arms in each other's place, not mirrored yet.

        Parameters
        ----------
        batch : dict of str to Tensor
            As `TPPWindows` gives it.
        name : str

        Returns
        -------
        Tensor
            What has no arms, as it is. ``between_valid`` asks a little more than the windows do:
            that all of ``action`` is measured at a step.

        Raises
        ------
        UsageError
            ``between`` comes without ``action``, which says how the first arm moved.
        """
        if name in ("action", "proprioception"):
            return batch[name][..., list(self.columns)]
        if name not in ("between", "between_valid"):
            return batch[name]
        missing = [key for key in ("action", "action_valid", "between_valid") if key not in batch]
        if missing:
            raise UsageError(f"{name!r} cannot be mirrored without {', '.join(missing)}")
        if name == "between":
            return self._between(batch["action"], batch["between"])
        at_zero = batch["between_valid"][:, self.zero : self.zero + 1]
        return at_zero & batch["action_valid"]

    def _between(self, action: Tensor, between: Tensor) -> Tensor:
        """Express the poses in the frame that the first one's partner has at step 0."""
        seen = []  # each pose at each step, from the first one at step 0
        for number, column in enumerate(self.poses):
            moved = _split(action[..., column : column + _NINE])
            if number:
                begin = (number - 1) * _NINE
                start = between[:, self.zero : self.zero + 1, begin : begin + _NINE]
                position, rotation = _split(start)
                moved = (_turned(rotation, moved[0]) + position, rotation @ moved[1])
            seen.append(moved)
        at_zero = slice(self.zero, self.zero + 1)
        position, rotation = (part[:, at_zero] for part in seen[self.partner[0]])
        back = rotation.transpose(-1, -2)
        columns = []
        for number in self.partner[1:]:
            moved = seen[number]
            columns.append(_turned(back, moved[0] - position))
            columns.append((back @ moved[1])[..., :2, :].flatten(-2))
        return torch.cat(columns, dim=-1)


def _split(nine: Tensor) -> tuple[Tensor, Tensor]:
    """Return position (..., 3) and rotation matrix (..., 3, 3) of poses of nine numbers."""
    first, second = nine[..., 3:6], nine[..., 6:9]
    third = torch.linalg.cross(first, second)
    return nine[..., :3], torch.stack((first, second, third), dim=-2)


def _turned(rotation: Tensor, vector: Tensor) -> Tensor:
    return (rotation @ vector[..., None])[..., 0]


def pose_columns(layout: Layout) -> tuple[int, ...]:
    """Return the columns of ``action`` at which poses begin.

    Parameters
    ----------
    layout : Layout
    """
    begins = _begins(layout.grippers)
    return tuple(
        begin for gripper, begin in zip(layout.grippers, begins, strict=True) if gripper.pose
    )


def arms_of(layout: Layout, *, zero: int) -> Arms | None:
    """Find out which gripper becomes which in a mirror.

    Parameters
    ----------
    layout : Layout
    zero : int
        Position of step 0 among the steps.

    Returns
    -------
    Arms or None
        None: there is one gripper, or none.

    Raises
    ------
    UsageError
        There are several, and one of them, or an image stream that says a side, has no partner.
    """
    grippers = layout.grippers
    if len(grippers) < 2:  # two make a pair
        return None
    partner = _partners(grippers)
    pairs = side_pairs(layout.images)
    lonely = [name for name in layout.images if other_side(name) != name and name not in pairs]
    if lonely:
        raise UsageError(
            f"the arms change places in a mirror, and {lonely[0]!r} has no "
            f"{other_side(lonely[0])!r} to change places with",
            fix="Give the windows both streams, or neither (tactile=..., rgb=...).",
        )
    begins = _begins(grippers)
    columns = [
        begins[partner[number]] + offset
        for number, gripper in enumerate(grippers)
        for offset in range(_width_of(gripper))
    ]
    posed = [number for number, gripper in enumerate(grippers) if gripper.pose]
    return Arms(
        tuple(columns),
        pose_columns(layout),
        tuple(posed.index(partner[number]) for number in posed),
        zero,
    )


def _partners(grippers: tuple[Gripper, ...]) -> list[int]:
    names = [gripper.pose or gripper.width or "" for gripper in grippers]
    pairs = side_pairs(names)
    for name in names:
        if name not in pairs:
            raise UsageError(
                f"of {len(names)} grippers {name!r} has no partner on the other side: which "
                "becomes which in a mirror is not known",
                fix="Streams of two arms are named by their side (pose_left, pose_right); or take "
                "one gripper: pose=..., width=....",
            )
    partner = [names.index(pairs[name]) for name in names]
    for number, other in enumerate(partner):
        if _width_of(grippers[number]) != _width_of(grippers[other]):
            raise UsageError(
                f"only one of {names[number]!r} and {names[other]!r} has a width",
                fix="Give the windows the width of both grippers, or of neither (width=...).",
            )
    return partner


def _width_of(gripper: Gripper) -> int:
    return _NINE * (gripper.pose is not None) + (gripper.width is not None)


def _begins(grippers: tuple[Gripper, ...]) -> list[int]:
    """Return the column at which each gripper begins."""
    begins = [0]
    for gripper in grippers:
        begins.append(begins[-1] + _width_of(gripper))
    return begins[:-1]
