"""The words of instruction samples: questions and answers about parts named ``1.1``, ``1.2``."""

from collections.abc import Sequence
from itertools import groupby
from typing import Literal, NamedTuple

from exumi_loaders.clips import Clip

__all__ = ["PLACEHOLDER", "Asked", "Ties", "answer_text", "question_text", "ranking"]

Ties = Literal["not_asked", "equal"]

PLACEHOLDER = "<tact_tokens>"
"""Where the frames of a part go, as Octopi-1.5 marks it."""


class Asked(NamedTuple):
    """What is asked about some parts.

    Attributes
    ----------
    describe : bool
    properties : tuple of str
        To rank by; empty where nothing is ranked.
    ties : {"not_asked", "equal"}
    """

    describe: bool
    properties: tuple[str, ...]
    ties: Ties


def question_text(asked: Asked, labels: Sequence[str]) -> str:
    """Write the question, with a placeholder for the frames of each part.

    Parameters
    ----------
    asked : Asked
    labels : sequence of str
        ``<object>.<part>`` of each part, in order.
    """
    many = len(labels) > 1
    what = f"the object part{'s' * many} in the following tactile video{'s' * many}"
    order = f"in decreasing {_listed(asked.properties)}" if asked.properties else ""
    if not asked.properties:
        task = f"Describe {what}."
    elif asked.describe:
        task = f"Describe {what} and rank them {order}."
    else:
        task = f"Rank {what} {order}."
    if asked.properties and asked.ties == "equal":
        task += " Join parts that are equal by =."
    return f"{task}\n\n{_by_object(labels, [PLACEHOLDER] * len(labels))}"


def answer_text(asked: Asked, labels: Sequence[str], clips: Sequence[Clip]) -> str:
    """Write the answer: descriptions first, rankings second.

    Parameters
    ----------
    asked : Asked
    labels : sequence of str
    clips : sequence of Clip
        One a part: with adjectives where it is described, with ratings where it is ranked.
    """
    paragraphs = []
    if asked.describe:
        described = [", ".join(clip.adjectives) + "." for clip in clips]
        paragraphs.append(_by_object(labels, described))
    if asked.properties:
        lines = [
            f"Object parts ranked in decreasing {name}: "
            f"{ranking(labels, [clip.labels[name] for clip in clips])}"
            for name in asked.properties
        ]
        paragraphs.append("\n".join(lines))
    return "\n\n".join(paragraphs)


def ranking(labels: Sequence[str], ratings: Sequence[float]) -> str:
    """Write labels in decreasing order of their ratings; equal ones are joined by ``=``."""
    ordered = sorted(zip(ratings, labels, strict=True), key=lambda pair: -pair[0])
    ranks = groupby(ordered, key=lambda pair: pair[0])
    return ", ".join(" = ".join(label for _, label in equal) for _, equal in ranks)


def _by_object(labels: Sequence[str], texts: Sequence[str]) -> str:
    pairs = list(zip(labels, texts, strict=True))
    paragraphs = []
    for number, members in groupby(pairs, key=lambda pair: pair[0].partition(".")[0]):
        lines = [f"Part {label}: {text}" for label, text in members]
        paragraphs.append("\n".join([f"Object {number}", *lines]))
    return "\n\n".join(paragraphs)


def _listed(names: Sequence[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last
