"""Counting labels."""

from collections import Counter
from collections.abc import Sequence
from statistics import median

from exumi_data.model.description import Label
from exumi_data.stats.model import Labels, Range

__all__ = ["count_labels"]


def count_labels(episodes: Sequence[Sequence[Label]]) -> list[Labels]:
    """Count the labels of episodes.

    Parameters
    ----------
    episodes : sequence of sequence of Label
        The labels of each episode. A label whose value is null counts as missing.

    Returns
    -------
    list of Labels
        One a property, sorted by property.
    """
    properties = sorted({label.property for labels in episodes for label in labels})
    return [_count(name, episodes) for name in properties]


def _count(name: str, episodes: Sequence[Sequence[Label]]) -> Labels:
    there = [
        [label for label in labels if label.property == name and label.value is not None]
        for labels in episodes
    ]
    found = [label for labels in there for label in labels]
    values = [label.value for label in found]
    numbers = [float(value) for value in values if isinstance(value, int | float)]
    words: Counter[str] = Counter()
    for value in values:
        words.update(
            [value] if isinstance(value, str) else value if isinstance(value, list) else []
        )
    labelled = sum(bool(labels) for labels in there)
    return Labels(
        property=name,
        episodes=labelled,
        missing=len(episodes) - labelled,
        numbers=Range(min(numbers), median(numbers), max(numbers)) if numbers else None,
        scales=[list(scale) for scale in sorted({tuple(x.scale) for x in found if x.scale})],
        words=dict(sorted(words.items(), key=lambda item: (-item[1], item[0]))),
        provenance=dict(sorted(Counter(label.provenance for label in found).items())),
    )
