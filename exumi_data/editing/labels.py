"""What people say of an episode, changed after the fact: task, things, labels, success, notes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from exumi_data.errors import UsageError
from exumi_data.model.description import Annotations, Label, QualityNote
from exumi_data.model.episode import EpisodeMetadata

__all__ = ["FIELDS", "Rating", "parse_label", "rate", "relabel"]

FIELDS = (
    "task",
    "instruction",
    "regime",
    "operator",
    "site",
    "licence",
    "object",
    "object_id",
    "part",
    "part_id",
    "instance_id",
    "procedure",
    "pad_type",
    "trial",
)
"""What `relabel` sets, in the order of its options."""
_OF_EPISODE = ("regime", "operator", "site", "licence")
_NEEDED = ("task", "regime", "licence")
_BY_ONE: dict[str, Any] = {"provenance": "human", "raters": 1}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rating:
    """A judgement of an episode.

    Attributes
    ----------
    success : bool or None
    is_judged : bool
        Whether `success` is said at all; else it stays.
    notes : mapping of str to str
        Code and message of notes on quality; one of the same code is replaced.
    without : tuple of str
        Codes of notes that are taken back.
    """

    success: bool | None = None
    is_judged: bool = False
    notes: Mapping[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()


def rate(metadata: EpisodeMetadata, rating: Rating) -> None:
    """Judge an episode.

    Parameters
    ----------
    metadata : EpisodeMetadata
        Changed in place.
    rating : Rating
    """
    if rating.is_judged:
        metadata.success = rating.success
    gone = {*rating.without, *rating.notes}
    there = {note.code: note for note in metadata.quality if note.stream is None}
    kept = [
        note
        for note in metadata.quality
        if note.code not in gone
        or (note.stream is not None and note.code not in rating.without)
        or (note.code in rating.notes and note.message == rating.notes[note.code])
    ]
    said = {note.code for note in kept if note.stream is None}
    for code, message in rating.notes.items():
        if code not in said:
            severity = there[code].severity if code in there else "warning"
            kept.append(QualityNote(code=code, message=message, severity=severity))
    metadata.quality = kept


def relabel(
    metadata: EpisodeMetadata,
    fields: Mapping[str, Any],
    *,
    labels: tuple[Label, ...] = (),
    without_labels: tuple[str, ...] = (),
) -> None:
    """Say anew what was done, with what, and what it is like.

    Parameters
    ----------
    metadata : EpisodeMetadata
        Changed in place.
    fields : mapping
        Names of `FIELDS`, and values; None takes what is there away.
    labels : tuple of Label
        A person's; a label of the same property by a person is replaced.
    without_labels : tuple of str
        Properties whose labels are taken away, whoever gave them.

    Raises
    ------
    UsageError
        A field that every episode has cannot be taken away.
    ValueError
        A value breaks the standard.
    """
    lost = [name for name in _NEEDED if name in fields and fields[name] is None]
    if lost:
        raise UsageError(f"an episode has to have: {', '.join(lost)}")
    for name, value in fields.items():
        if name == "task":
            metadata.task = metadata.task.model_copy(update={"name": value})
        elif name == "instruction":
            metadata.task = metadata.task.model_copy(update={"instruction": value})
        elif name in _OF_EPISODE:
            setattr(metadata, name, value)
    of_things = {
        name: value
        for name, value in fields.items()
        if name not in (*_OF_EPISODE, "task", "instruction")
    }
    if of_things or labels or without_labels:
        _annotate(metadata, of_things, labels, without_labels)


def _annotate(
    metadata: EpisodeMetadata,
    fields: Mapping[str, Any],
    labels: tuple[Label, ...],
    without_labels: tuple[str, ...],
) -> None:
    annotations = metadata.annotations or Annotations()
    for name, value in fields.items():
        if value is not None or getattr(annotations, name) is not None:
            setattr(annotations, name, value)
    told = {label.property for label in labels}
    kept = [
        label
        for label in annotations.labels or []
        if label.property not in without_labels
        and not (label.property in told and label.provenance == "human")
    ]
    if labels or annotations.labels is not None:
        annotations.labels = [*kept, *labels]
    if annotations.model_fields_set:
        metadata.annotations = annotations


def parse_label(text: str) -> Label:
    """Read a label as it is typed: ``hardness=7:0..10`` is 7 of 0 to 10, ``material=wood`` a word.

    Parameters
    ----------
    text : str
        ``PROPERTY=VALUE`` or ``PROPERTY=NUMBER:LOW..HIGH``.

    Returns
    -------
    Label
        Given by a person.

    Raises
    ------
    UsageError
        It is none.
    """
    name, divided, value = text.partition("=")
    if not divided or not name.strip() or not value.strip():
        raise UsageError(
            f"{text!r} is no label", fix="Write PROPERTY=VALUE, such as hardness=7:0..10."
        )
    number, scaled, scale = value.partition(":")
    try:
        if not scaled or ".." not in scale:
            return Label(property=name, value=_number_or_word(value), **_BY_ONE)
        low, high = (float(end) for end in scale.split(".."))
        if low < high and not low <= float(number) <= high:
            raise UsageError(
                f"{text!r}: {number} is not on its scale", fix="Write it such as hardness=7:0..10."
            )
        if low < high:
            return Label(property=name, value=float(number), scale=[low, high], **_BY_ONE)
    except ValueError:
        pass
    raise UsageError(f"{text!r} has no number on a scale", fix="Write it such as hardness=7:0..10.")


def _number_or_word(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
