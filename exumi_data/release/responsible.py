"""How a dataset was collected, labelled and changed, in the words of Croissant's RAI vocabulary.

Of https://docs.mlcommons.org/croissant/docs/croissant-rai-spec.html, what the episodes say.
"""

from typing import Any

from exumi_data.dataset import Dataset
from exumi_data.release.facts import Facts, LabelKind, Step

__all__ = ["responsible_of", "told_label", "told_step"]

_MOST = 50
_WITNESSES = {"rgb": "cameras may show people and rooms", "audio": "sound may hold voices"}


def responsible_of(dataset: Dataset, facts: Facts) -> dict[str, Any]:
    """Return the properties that are known; the others are left out.

    Parameters
    ----------
    dataset : Dataset
    facts : Facts
        Of the dataset.

    Returns
    -------
    dict
        Croissant's names, with ``rai:``.
    """
    starts = sorted(start for start in dataset.catalog.column("start").to_pylist() if start)
    kinds = {stream.kind for stream in facts.streams}
    seen = [text for kind, text in _WITNESSES.items() if kind in kinds]
    raters = sorted({label.raters for label in facts.labels if label.raters})
    made = {
        "dataCollection": _collection(dataset, facts),
        "dataCollectionRawData": "Samples are stored as the sensors gave them, each stream at its "
        "own rate and with its own clock; what was lost is listed as preprocessing."
        if facts.streams
        else None,
        "dataCollectionTimeFrame": [starts[0], starts[-1]] if starts else None,
        "dataCollectionMissingData": _notes(facts),
        "dataPreprocessingProtocol": [told_step(step) for step in list(facts.steps)[:_MOST]],
        "dataAnnotationProtocol": [told_label(label) for label in list(facts.labels)[:_MOST]],
        "annotationsPerItem": ", ".join(map(str, raters)),
        "personalSensitiveInformation": [f"{text}: nothing checks it" for text in seen],
    }
    return {f"rai:{name}": value for name, value in made.items() if value}


def told_step(step: Step) -> str:
    """Return a lossy step as a sentence."""
    about = f" of {step.stream}" if step.stream else ""
    by = f", by {step.by}" if step.by else ""
    return f"{step.step}{about}: {step.detail}{by}"


def told_label(label: LabelKind) -> str:
    """Return how a property was judged."""
    parts = [f"by a {label.provenance}" if label.provenance == "model" else "by people"]
    if label.scale:
        parts.append("from {:g} to {:g}".format(*label.scale))
    if label.raters:
        parts.append(f"{label.raters} raters a value" if label.raters > 1 else "one rater a value")
    if label.origin:
        parts.append(f"taken from {label.origin}")
    return f"{label.property}: {', '.join(parts)}"


def _collection(dataset: Dataset, facts: Facts) -> str:
    regimes = sorted(set(dataset.catalog.column("regime").to_pylist()))
    ways = [
        f"{count} {kind} by {tool} {version}" + (f" ({converter})" if converter else "")
        for (kind, tool, version, converter), count in facts.sources.items()
    ]
    return f"Episodes of the regimes {', '.join(regimes)}: {'; '.join(ways)}." if ways else ""


def _notes(facts: Facts) -> str:
    codes: dict[str, int] = {}
    for (code, _), count in facts.notes.items():
        codes[code] = codes.get(code, 0) + count
    return ", ".join(f"{code} in {count} episodes" for code, count in sorted(codes.items()))
