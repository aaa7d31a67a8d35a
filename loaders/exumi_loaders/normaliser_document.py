"""What a normaliser was fitted to and what it found: its JSON."""

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from exumi_data.model.base import Identifier, Model, Version
from exumi_loaders.policy_spec import PolicySpec

__all__ = ["NORMALISER_FORMAT", "Channels", "NormaliserDocument"]

NORMALISER_FORMAT = "exumi-normaliser"

_CONSTANT = 1e-4
"""A channel that varies by less is constant: 0.1 mm, which no gripper is moved by on purpose."""

_Numbers = tuple[float, ...]


class Channels(Model):
    """The channels of one key, and how they are distributed."""

    model_config = ConfigDict(frozen=True)

    columns: tuple[Identifier, ...]
    count: Annotated[int, Field(ge=1)]
    """Valid samples that it was fitted to."""
    minimum: _Numbers
    maximum: _Numbers
    mean: _Numbers
    deviation: _Numbers

    @model_validator(mode="after")
    def _as_many_as_columns(self) -> "Channels":
        for name in ("minimum", "maximum", "mean", "deviation"):
            if len(getattr(self, name)) != len(self.columns):
                msg = f"{name} has not one number for each of the {len(self.columns)} columns"
                raise ValueError(msg)
        return self

    def scale_and_offset(self, mode: str, *, keep_rotations: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return what values are multiplied by, and then shifted by, (C,) float64 each.

        Parameters
        ----------
        mode : {"limits", "gaussian"}
        keep_rotations : bool
        """
        low, high = np.array(self.minimum), np.array(self.maximum)
        constant = high - low < _CONSTANT
        if mode == "limits":
            middle, spread = (low + high) / 2, (high - low) / 2
        else:
            middle, spread = np.array(self.mean), np.array(self.deviation)
        scale = 1 / np.where(constant, 1, spread)
        offset = -middle * scale
        if keep_rotations:
            kept = np.array([_is_rotation(column) for column in self.columns])
            scale, offset = np.where(kept, 1, scale), np.where(kept, 0, offset)
        return scale, offset


class NormaliserDocument(Model):
    """What a normaliser was fitted to, and what it found: its JSON."""

    model_config = ConfigDict(frozen=True)

    format: Literal["exumi-normaliser"] = "exumi-normaliser"
    version: Version = "1.0"
    mode: Literal["limits", "gaussian"]
    keep_rotations: bool
    keys: dict[Identifier, Channels]
    fitted_to: tuple[PolicySpec, ...]
    """The windows: their settings, the digest of their dataset and their split."""


def _is_rotation(column: str) -> bool:
    name = column.rpartition(".")[-1]
    return len(name) == 3 and name.startswith("r") and name[1:].isdigit()
