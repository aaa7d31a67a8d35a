"""What a session is to record, and the document of each of its episodes."""

import os
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from exumi_data._version import __version__
from exumi_data.errors import UsageError
from exumi_data.model import (
    Annotations,
    CalibrationItem,
    Device,
    EpisodeMetadata,
    Source,
    Task,
)
from exumi_data.release.licence import stated_licence
from exumi_recorders.rig.model import Rig
from exumi_recorders.session.labels import TouchLabels

__all__ = [
    "Calibrated",
    "Plan",
    "Regime",
    "check_plan",
    "episode_document",
    "licence_of",
    "new_episode_id",
]

Regime = Literal["demonstration", "play", "touch"]

_TOOL = "exumi record"


@dataclass(frozen=True)
class Calibrated:
    """What is known of a rig when the session begins.

    Attributes
    ----------
    items : dict of str to CalibrationItem
        Copied into every episode.
    arrays : dict of str to ndarray
        By path below ``calibration/``.
    """

    items: Mapping[str, CalibrationItem] = field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What a session is to record.

    Attributes
    ----------
    task : str
        Name of the task.
    instruction : str, optional
        The task in plain language.
    regime : {"demonstration", "play", "touch"}
    labels : TouchLabels
    duration_s : float, optional
        An episode ends by itself after this.
    auto : bool
        Begin at once, and again after each episode.
    pause_s : float
        Between automatic episodes.
    episodes : int, optional
        The session ends when so many are kept.
    operator, site, licence : str, optional
        In place of the rig file's.
    is_simulated : bool
        Nothing is measured, and the episodes say so.
    uncalibrated : bool
        Record although the encoder has no map to widths, such as to calibrate by it.
    """

    task: str
    instruction: str | None = None
    regime: Regime = "demonstration"
    labels: TouchLabels = field(default_factory=TouchLabels)
    duration_s: float | None = None
    auto: bool = False
    pause_s: float = 3.0
    episodes: int | None = None
    operator: str | None = None
    site: str | None = None
    licence: str | None = None
    is_simulated: bool = False
    uncalibrated: bool = False


def check_plan(plan: Plan) -> None:
    """Refuse what an episode could not say, before anything is opened.

    Parameters
    ----------
    plan : Plan

    Raises
    ------
    UsageError
        Names all options that are wrong.
    """
    texts = {
        "instruction": plan.instruction,
        "operator": plan.operator,
        "site": plan.site,
    }
    wrong = [f"--{name} is no text in UTF-8" for name, text in texts.items() if not _is_text(text)]
    for make in (
        lambda: Task(**_given({"name": plan.task, "instruction": plan.instruction})),
        lambda: plan.labels.annotations(1),
        lambda: _about(plan),
    ):
        try:
            make()
        except ValidationError as error:
            wrong += [_said(item) for item in error.errors()]
    if plan.licence is not None:
        try:
            stated_licence(plan.licence)
        except UsageError as error:
            wrong.append(f"--licence: {error.what}")
    if wrong:
        raise UsageError("; ".join(dict.fromkeys(wrong)), fix="Say something shorter, or simpler.")


def licence_of(plan: Plan, rig: Rig) -> str:
    """Return the licence of what is recorded: that of the session, or else of the rig file.

    Parameters
    ----------
    plan : Plan
        Checked with `check_plan`.
    rig : Rig
    """
    return rig.about.licence if plan.licence is None else stated_licence(plan.licence)


def _is_text(text: str | None) -> bool:
    """Whether it can be written: what was typed in another encoding cannot."""
    try:
        (text or "").encode()
    except UnicodeEncodeError:
        return False
    return True


def _about(plan: Plan) -> EpisodeMetadata:
    return EpisodeMetadata(
        id="00000000-0000-7000-8000-000000000000",
        task=Task(name="task"),
        regime=plan.regime,
        licence="NOASSERTION",
        source=Source(type="recorded", tool=_TOOL, tool_version=__version__),
        **_given({"operator": plan.operator, "site": plan.site}),
    )


def _said(item: Mapping[str, Any]) -> str:
    field = str(item["loc"][0])
    option = "--" + {"name": "task"}.get(field, field.removesuffix("_id"))
    if item["type"] == "string_pattern_mismatch":
        return f"{option} has to be one line of 1 to 255 characters, without blanks at its ends"
    if item["type"] == "string_unicode":
        return f"{option} is no text in UTF-8"
    return f"{option}: {item['msg']}"


def new_episode_id() -> str:
    """Return a UUIDv7 (RFC 9562): it sorts by the time at which it was made."""
    milliseconds = time.time_ns() // 1_000_000
    number = milliseconds << 80 | int.from_bytes(os.urandom(10))
    number = number & ~(0xF << 76) | 7 << 76
    number = number & ~(0x3 << 62) | 2 << 62
    return str(uuid.UUID(int=number))


def episode_document(
    rig: Rig, plan: Plan, calibrated: Calibrated, annotations: Annotations | None
) -> EpisodeMetadata:
    """Return the document of the next episode, without its streams.

    Parameters
    ----------
    rig : Rig
    plan : Plan
    calibrated : Calibrated
    annotations : Annotations, optional
    """
    about = rig.about
    optional: dict[str, Any] = {
        "operator": plan.operator or about.operator,
        "site": plan.site or about.site,
        "embodiment": rig.embodiment,
        "annotations": annotations,
    }
    device = {"name": about.name, "serial": about.serial, "hub": about.hub}
    task = {"name": plan.task, "instruction": plan.instruction}
    return EpisodeMetadata(
        id=new_episode_id(),
        task=Task(**_given(task)),
        regime=plan.regime,
        device=Device(**_given(device)),
        calibration=dict(calibrated.items),
        licence=licence_of(plan, rig),
        source=Source(
            type="simulated" if plan.is_simulated else "recorded",
            tool=_TOOL,
            tool_version=__version__,
        ),
        **_given(optional),
    )


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}
