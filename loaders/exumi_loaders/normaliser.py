"""Actions and proprioception on a common scale: fitted once, kept as JSON beside the dataset."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from exumi_data.errors import UsageError
from exumi_loaders.channel_statistics import ChannelStatistics
from exumi_loaders.concat import ConcatWindows
from exumi_loaders.documents import read_document, write_beside
from exumi_loaders.normaliser_document import NORMALISER_FORMAT, Channels, NormaliserDocument
from exumi_loaders.options import one_of
from exumi_loaders.policy import PolicyWindows
from exumi_loaders.policy_spec import PolicySpec

__all__ = ["Normaliser"]

_BLOCK = 4096
_PADDING = {"action": "action_padding"}


class Normaliser(nn.Module):
    """Put actions and proprioception on a common scale, channel by channel.

    ``limits`` maps the range of a channel to [-1, 1]; ``gaussian`` its mean to 0 and its standard
    deviation to 1. A channel that varies by less than 10⁻⁴ (0.1 mm) is only shifted to 0, never
    stretched. Rotations (six numbers in [-1, 1]) stay as they are, unless asked for. What is
    outside the range of the training data comes out outside [-1, 1]: nothing is clipped.

    Make one with `fit` or `load`. It has no weights to train; ``state_dict`` holds its numbers.

    Parameters
    ----------
    document : NormaliserDocument
        Of `fit` or of a file.

    Attributes
    ----------
    document : NormaliserDocument

    Examples
    --------
    >>> normaliser = Normaliser.fit(windows)  # doctest: +SKIP
    >>> normaliser.save("runs/7/normaliser.json")  # doctest: +SKIP
    >>> scaled = normaliser.normalise(batch)  # doctest: +SKIP
    """

    def __init__(self, document: NormaliserDocument) -> None:
        super().__init__()
        self.document = document
        for key, channels in document.keys.items():
            scale, offset = channels.scale_and_offset(
                document.mode, keep_rotations=document.keep_rotations
            )
            self.register_buffer(f"{key}_scale", torch.tensor(scale, dtype=torch.float32))
            self.register_buffer(f"{key}_offset", torch.tensor(offset, dtype=torch.float32))

    @classmethod
    def fit(
        cls,
        windows: PolicyWindows | ConcatWindows,
        *,
        mode: Literal["limits", "gaussian"] = "limits",
        keep_rotations: bool = True,
        any_split: bool = False,
    ) -> "Normaliser":
        """Fit to all windows of a training split; no image is decoded.

        Only what is valid counts, and no padding.

        Parameters
        ----------
        windows : PolicyWindows or ConcatWindows
            Each with ``split="train"``, or ``"<name>/train"``.
        mode : {"limits", "gaussian"}
        keep_rotations : bool
            Leave the six numbers of a rotation as they are.
        any_split : bool
            Take windows of any split, or of none.

        Returns
        -------
        Normaliser

        Raises
        ------
        UsageError
            The windows are not of a training split, or nothing in them is valid.
        """
        one_of("mode", mode, ("limits", "gaussian"))
        parts = list(_parts(windows))
        for part in parts:
            if not any_split and (part.split or "").rpartition("/")[-1] != "train":
                raise UsageError(
                    f"a normaliser is fitted to the training split only, not to {part.split!r}: "
                    "what is tested on would be known",
                    where=part.episodes.path,
                    fix='PolicyWindows(..., split="train"), or any_split=True if there is nothing '
                    "to be tested.",
                )
        columns = {"action": parts[0].action_columns}
        if parts[0].policy_spec.proprioception:
            columns["proprioception"] = parts[0].action_columns
        if "between" in parts[0].spec:
            columns["between"] = parts[0].between_columns
        keys = {key: _channels(parts, key, names) for key, names in columns.items()}
        fitted_to = tuple(part.policy_spec for part in parts)
        return cls(
            NormaliserDocument(
                mode=mode, keep_rotations=keep_rotations, keys=keys, fitted_to=fitted_to
            )
        )

    def normalise(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Scale the keys that it knows; the others are passed on as they are.

        Parameters
        ----------
        batch : mapping of str to Tensor
            (..., C) each.
        """
        return self._each(batch, lambda value, scale, offset: value * scale + offset)

    def unnormalise(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Undo `normalise`.

        Parameters
        ----------
        batch : mapping of str to Tensor
            (..., C) each.
        """
        return self._each(batch, lambda value, scale, offset: (value - offset) / scale)

    def forward(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Do as `normalise`.

        Parameters
        ----------
        batch : mapping of str to Tensor
        """
        return self.normalise(batch)

    def _each(self, batch: Mapping[str, Tensor], apply: Any) -> dict[str, Tensor]:
        out = dict(batch)
        for key, channels in self.document.keys.items():
            if key not in batch:
                continue
            if batch[key].shape[-1] != len(channels.columns):
                raise UsageError(
                    f"{key} has {batch[key].shape[-1]} channels, the normaliser was fitted to "
                    f"{len(channels.columns)}"
                )
            out[key] = apply(
                batch[key], self.get_buffer(f"{key}_scale"), self.get_buffer(f"{key}_offset")
            )
        return out

    def check(self, data: PolicyWindows | ConcatWindows | PolicySpec) -> None:
        """Refuse data whose numbers mean something else than those that it was fitted to.

        Parameters
        ----------
        data : PolicyWindows, ConcatWindows or PolicySpec

        Raises
        ------
        UsageError
            Names the setting that differs.
        """
        fitted = self.document.fitted_to[0].motion
        specs = [data] if isinstance(data, PolicySpec) else [p.policy_spec for p in _parts(data)]
        for spec in specs:
            for name, value in spec.motion.items():
                if value != fitted[name]:
                    raise UsageError(
                        f"the normaliser was fitted to windows with {name} {fitted[name]}, these "
                        f"have {value}",
                        fix="Fit one to the training split of these windows.",
                    )

    def save(self, path: Path | str) -> None:
        """Write it as JSON, never into a dataset.

        Parameters
        ----------
        path : path

        Raises
        ------
        UsageError
            The file would lie within a dataset or an episode.
        """
        write_beside(self.document, Path(path))

    @classmethod
    def load(cls, path: Path | str) -> "Normaliser":
        """Read what `save` has written.

        Parameters
        ----------
        path : path

        Raises
        ------
        MetadataError
            It is something else.
        """
        return cls(read_document(NormaliserDocument, Path(path), NORMALISER_FORMAT))


def _parts(windows: PolicyWindows | ConcatWindows) -> Iterator[PolicyWindows]:
    if isinstance(windows, PolicyWindows):
        yield windows
    elif isinstance(windows, ConcatWindows):
        for part in windows.parts:
            yield from _parts(part)  # type: ignore[arg-type]  # the else branch refuses others
    else:
        raise UsageError(f"a normaliser is of PolicyWindows, not of {type(windows).__name__}")


def _channels(parts: list[PolicyWindows], key: str, columns: tuple[str, ...]) -> Channels:
    found = ChannelStatistics.of(_valid_rows(parts, key), len(columns))
    if not found.count:
        raise UsageError(f"no valid {key} in any window", where=parts[0].episodes.path)
    return Channels(
        columns=columns,
        count=found.count,
        minimum=tuple(found.minimum.tolist()),
        maximum=tuple(found.maximum.tolist()),
        mean=tuple(found.mean.tolist()),
        deviation=tuple(found.deviation.tolist()),
    )


def _valid_rows(parts: list[PolicyWindows], key: str) -> Iterator[np.ndarray]:
    """Yield the valid rows of a key, (N, C) float32, of a block of windows at a time."""
    for part in parts:
        for start in range(0, len(part), _BLOCK):
            arrays = part.low_dimensional(np.arange(start, min(start + _BLOCK, len(part))))
            padding = arrays[_PADDING.get(key, "observation_padding")]
            yield arrays[key][arrays[f"{key}_valid"] & ~padding]
