"""Questions and answers, word for word."""

import pytest

from exumi_loaders.clips import Clip
from exumi_loaders.instruction_text import Asked, answer_text, question_text, ranking


def clip(*adjectives: str, **labels: float) -> Clip:
    return Clip(0, "id", "tactile", (8, 8, 1), adjectives=adjectives, labels=labels)


def test_descriptions_come_first_and_rankings_second() -> None:
    asked = Asked(describe=True, properties=("hardness", "roughness"), ties="not_asked")
    labels = ["1.1", "1.2", "2.1"]
    clips = [
        clip("smooth", "flat", hardness=2.0, roughness=1.0),
        clip("soft", hardness=1.0, roughness=3.0),
        clip("stiff", hardness=9.0, roughness=2.0),
    ]
    assert question_text(asked, labels) == (
        "Describe the object parts in the following tactile videos and rank them in decreasing "
        "hardness and roughness.\n\n"
        "Object 1\nPart 1.1: <tact_tokens>\nPart 1.2: <tact_tokens>\n\n"
        "Object 2\nPart 2.1: <tact_tokens>"
    )
    assert answer_text(asked, labels, clips) == (
        "Object 1\nPart 1.1: smooth, flat.\nPart 1.2: soft.\n\n"
        "Object 2\nPart 2.1: stiff.\n\n"
        "Object parts ranked in decreasing hardness: 2.1, 1.1, 1.2\n"
        "Object parts ranked in decreasing roughness: 1.2, 2.1, 1.1"
    )


def test_one_part_is_described_alone() -> None:
    asked = Asked(describe=True, properties=(), ties="not_asked")
    assert question_text(asked, ["1.1"]) == (
        "Describe the object part in the following tactile video.\n\n"
        "Object 1\nPart 1.1: <tact_tokens>"
    )
    assert answer_text(asked, ["1.1"], [clip("soft")]) == "Object 1\nPart 1.1: soft."


def test_a_decision_alone_and_what_equal_means() -> None:
    asked = Asked(describe=False, properties=("hardness",), ties="equal")
    question = question_text(asked, ["1.1", "2.1"])
    assert question.startswith(
        "Rank the object parts in the following tactile videos in decreasing hardness. "
        "Join parts that are equal by =.\n\n"
    )
    clips = [clip(hardness=1.0), clip(hardness=1.0)]
    assert answer_text(asked, ["1.1", "2.1"], clips) == (
        "Object parts ranked in decreasing hardness: 1.1 = 2.1"
    )


@pytest.mark.parametrize(
    ("ratings", "said"),
    [
        ([1.0, 2.0, 3.0], "c, b, a"),
        ([2.0, 1.0, 2.0], "a = c, b"),
        ([1.0, 1.0, 1.0], "a = b = c"),
        ([5.0, 1.0, 1.0], "a, b = c"),
    ],
)
def test_rankings_join_what_is_equal(ratings: list[float], said: str) -> None:
    assert ranking(["a", "b", "c"], ratings) == said
