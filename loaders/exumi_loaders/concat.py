"""Windows of several datasets as one."""

from collections.abc import Mapping, Sequence

import numpy as np
from torch.utils.data import Sampler

from exumi_data.errors import UsageError
from exumi_loaders.active_sampler import ActiveWindowSampler
from exumi_loaders.buffers import ItemSpec
from exumi_loaders.sampler import WindowIndex
from exumi_loaders.windows import Windows

__all__ = ["ConcatWindows"]


class ConcatWindows(Windows):
    """Windows of several datasets, one after the other, in one loader.

    A batch holds windows of any of them, filled in place. An item has the keys of its parts and

    =========  ==========  ==============================================================
    key        shape       meaning
    =========  ==========  ==============================================================
    ``part``   () int64    position in ``windows.parts``; ``episode`` counts within it
    =========  ==========  ==============================================================

    Parameters
    ----------
    parts : sequence of Windows
        Such as `TPPWindows`, whose items are alike in every key.
    weights : sequence of float, optional
        How much of what is drawn comes from each part, relative to the others and however large
        it is. Default: every window once an epoch.
    seed : int
        Of the order.

    Attributes
    ----------
    parts : tuple of Windows
    weights : (len(self),) float64 or None
        Weight of each window, for `ActiveWindowSampler`: a part's weight shared out among its
        windows. The sampler's rejection of inactive windows comes after it, as in the loop that
        it stands for: a part that touches little is drawn from less.

    Raises
    ------
    UsageError
        There are no parts, two differ in shape or meaning (the key is named), or weights are not
        one positive number a part.

    Examples
    --------
    >>> both = ConcatWindows([play, demonstrations], weights=[1, 3])  # doctest: +SKIP
    >>> for batch in both.loader(64):  # doctest: +SKIP
    ...     batch["part"]
    """

    def __init__(
        self, parts: Sequence[Windows], *, weights: Sequence[float] | None = None, seed: int = 0
    ) -> None:
        super().__init__(seed)
        if not parts:
            raise UsageError("there are no windows to join")
        self.parts = tuple(parts)
        for number, part in enumerate(self.parts[1:], start=1):
            _check_alike(self.parts[0], part, number)
        self._spec = {**self.parts[0].spec, "part": ItemSpec((), "int64")}
        self._edges = np.cumsum([0, *map(len, self.parts)])
        self.weights = None if weights is None else self._window_weights(weights)

    def _window_weights(self, weights: Sequence[float]) -> np.ndarray:
        wanted = np.asarray(weights, dtype=np.float64)
        if wanted.shape != (len(self.parts),) or not (np.isfinite(wanted) & (wanted > 0)).all():
            raise UsageError(
                f"weights are {list(weights)}, expected {len(self.parts)} positive numbers, one a "
                "part"
            )
        counts = np.diff(self._edges)
        if not counts.all():
            raise UsageError(f"part {int(counts.argmin())} has a weight, but no windows")
        return np.repeat(wanted / wanted.sum() / counts, counts)

    def __len__(self) -> int:
        return int(self._edges[-1])

    def __repr__(self) -> str:
        return f"<ConcatWindows: {len(self)} windows of {len(self.parts)} datasets>"

    @property
    def active(self) -> np.ndarray:
        """(len(self),) bool: which windows are active, from stored activity.

        Raises
        ------
        UsageError
            Not all episodes have stored activity.
        """
        return np.concatenate([part.active for part in self.parts])

    @property
    def spec(self) -> Mapping[str, ItemSpec]:
        """Shape and type of each key of an item."""
        return self._spec

    @property
    def alike(self) -> Mapping[str, object]:
        """What windows must have in common with others to be mixed, beside their shapes."""
        return self.parts[0].alike

    def fill(
        self, arrays: Mapping[str, np.ndarray], rows: np.ndarray, epochs: np.ndarray, at: np.ndarray
    ) -> None:
        """Fill some rows of a batch, each from its part.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            One for each key of `spec`, with an axis for the batch in front. What stays JPEG files
            is an array of their bytes, with None where there is no frame.
        rows : (R,) int64
            The rows to fill.
        epochs : (R,) int64
            The epoch of each window.
        at : (R,) int64
            Which window it is, in [0, len(self)).
        """
        owner = np.searchsorted(self._edges, at, side="right") - 1
        for number in np.unique(owner).tolist():
            mine = owner == number
            self.parts[number].fill(
                arrays, rows[mine], epochs[mine], at[mine] - self._edges[number]
            )
        arrays["part"][rows] = owner

    def _default_sampler(self, *, shuffle: bool, reject_inactive: float) -> Sampler[WindowIndex]:
        if self.weights is None:
            return super()._default_sampler(shuffle=shuffle, reject_inactive=reject_inactive)
        if not shuffle:
            raise UsageError(
                "weighted parts have no order of their own",
                fix="Leave shuffle=True, or give no weights.",
            )
        return ActiveWindowSampler(
            self, reject=reject_inactive, weights=self.weights, seed=self._seed
        )


def _check_alike(first: Windows, other: Windows, number: int) -> None:
    mine, its = first.spec, other.spec
    for key in {**mine, **its}:
        if key not in mine or key not in its:
            has, lacks = (0, number) if key in mine else (number, 0)
            raise UsageError(
                f"part {has} has {key!r}, part {lacks} has not",
                fix="Give both the same streams (tactile=, rgb=, pose=, width=) and options.",
            )
        if mine[key] != its[key]:
            only_files_differ = mine[key]._replace(files=its[key].files) == its[key]
            raise UsageError(
                f"{key!r} is {mine[key]} in part 0 and {its[key]} in part {number}",
                fix='Give both decode="cpu": frames of one are not stored as JPEG files, or were '
                "not asked for as such."
                if only_files_differ
                else "Make frames of one size first (exumi prepare SRC DST --size 224), and give "
                "both windows the same options.",
            )
    for name, value in first.alike.items():
        if other.alike.get(name) != value:
            raise UsageError(
                f"{name}: {value} in part 0 and {other.alike.get(name)} in part {number}",
                fix="What has another meaning in each part cannot be mixed.",
            )
