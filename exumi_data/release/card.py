"""The card of a dataset: what a stranger has to know, in one page with pictures."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from exumi_data.dataset import Dataset, open_dataset
from exumi_data.model.episode import UNKNOWN_LICENCE
from exumi_data.release.card_header import header_of
from exumi_data.release.citation import Edition, bibtex_of, edition_of
from exumi_data.release.facts import Facts, facts_of
from exumi_data.release.licence import NO_LICENCE
from exumi_data.release.limits import known_limits
from exumi_data.release.markdown import (
    amount,
    bytes_text,
    code_block,
    duration,
    listed,
    plain,
    table,
)
from exumi_data.release.pictures import pictures_of
from exumi_data.release.responsible import told_step
from exumi_data.stats import Statistics, measure
from exumi_data.stats.model import Range

__all__ = ["CARD_NAME", "PICTURES_FOLDER", "Card", "Finding", "card_of"]

CARD_NAME = "README.md"
PICTURES_FOLDER = "pictures"

_ALT = {
    "touch.png": "Frames of the tactile sensors in contact",
    "camera.png": "Frames of the cameras",
    "signals.png": "Signals of one episode over time",
}
_MOST_THINGS = 20
_MOST_WORDS = 6
_LONGEST_WORD = 50
_LONGEST_PARAGRAPH = 5000


class Finding(Protocol):
    """What a validator found by one rule, once or more often."""

    @property
    def code(self) -> str:
        """Id of the rule."""
        ...

    @property
    def severity(self) -> str:
        """``error``, ``warning`` or ``info``."""
        ...

    @property
    def message(self) -> str:
        """What is wrong, the first time."""
        ...

    @property
    def count(self) -> int:
        """How often."""
        ...


@dataclass(frozen=True, slots=True)
class Card:
    """A dataset card.

    Attributes
    ----------
    text : str
        Markdown with a YAML head: ``README.md``.
    pictures : dict of str to bytes
        PNG files that it shows, by path below the dataset.
    """

    text: str
    pictures: dict[str, bytes]


def card_of(
    root: str | os.PathLike[str],
    findings: Sequence[Finding] | None = None,
    *,
    edition: Edition | None = None,
    repository: str | None = None,
    workers: int | None = None,
) -> Card:
    """Make the card of a finished dataset. Nothing is written; a handful of frames is decoded.

    The same dataset gives the same card.

    Parameters
    ----------
    root : path-like
        The dataset's folder.
    findings : sequence of Finding, optional
        Of the validator; None: it was not asked.
    edition : Edition, optional
        Which edition it is, where ``dataset.json`` does not say.
    repository : str, optional
        ``owner/name`` on the Hugging Face hub, for the lines that load it.
    workers : int, optional
        Processes that measure. Default: one for up to 200 episodes, else all cores.

    Returns
    -------
    Card

    Raises
    ------
    ExumiError
        The dataset cannot be read.
    """
    dataset = open_dataset(Path(root))
    about = edition_of(dataset.metadata, edition)
    facts, numbers = facts_of(dataset), measure(dataset, workers=workers)
    pictures = pictures_of(dataset)
    parts = [
        [header_of(dataset, facts), ""],
        _head(dataset, pictures),
        _content(dataset, numbers, facts),
        _making(numbers, facts),
        _sensors(facts),
        _splits(dataset),
        _quality(numbers, facts, findings),
        _labels(numbers, facts),
        _licence(dataset, facts),
        _citation(dataset, about),
        _loading(dataset, repository),
        _section("Known limits", listed(known_limits(numbers, facts))),
    ]
    text = "\n".join(line for part in parts for line in part).rstrip() + "\n"
    return Card(text, {f"{PICTURES_FOLDER}/{name}": data for name, data in pictures.items()})


def _section(name: str, lines: Sequence[str]) -> list[str]:
    return [f"## {name}", "", *lines] if lines else []


def _head(dataset: Dataset, pictures: dict[str, bytes]) -> Iterator[str]:
    yield from (f"# {plain(dataset.metadata.name)}", "")
    if dataset.metadata.description:
        for paragraph in dataset.metadata.description.split("\n\n"):
            yield from (plain(paragraph, most=_LONGEST_PARAGRAPH), "")
    for name in pictures:
        yield from (f"![{_ALT[name]}]({PICTURES_FOLDER}/{name})", "")


def _content(dataset: Dataset, numbers: Statistics, facts: Facts) -> list[str]:
    content = numbers.content
    things = {
        "tasks": len([name for name in content.tasks if name]),
        "objects": len([name for name in content.objects if name]),
        "parts of objects": len([name for name in content.parts if name]),
    }
    length = numbers.episode_duration_s
    rows: list[tuple[str, str]] = [
        ("episodes", f"{numbers.episodes:,}"),
        ("recorded time", duration(numbers.duration_s)),
        ("an episode lasts", _range(length, "s") if length else ""),
        ("size", bytes_text(sum(dataset.catalog.column("bytes").to_pylist()))),
        *((name, f"{count:,}") for name, count in things.items()),
    ]
    rows += [(f"of these {name}", f"{r.episodes:,}") for name, r in numbers.regimes.items()]
    lines = table(("", ":"), [row for row in rows if row[1] not in ("", "0")])
    lines += _streams(numbers, facts)
    for title, counts in (
        ("Task", content.tasks),
        ("Object", content.objects),
        ("Part", content.parts),
        ("Procedure", content.procedures),
    ):
        known = {name: count for name, count in counts.items() if name}
        if len(known) > 1 or (known and title == "Task"):
            lines += table((title, "Episodes:"), known.items(), most=_MOST_THINGS)
    return _section("What it holds", lines)


def _streams(numbers: Statistics, facts: Facts) -> list[str]:
    stored: dict[str, dict[str, None]] = {}
    for fact in facts.streams:
        stored.setdefault(fact.name, {})[fact.stored] = None
    return table(
        ("Stream", "Kind", "Stored as", "Rate:", "Episodes:", "Samples:", "Size:"),
        [
            (
                one.name,
                one.kind,
                "; ".join(name for name in stored.get(one.name, {}) if name),
                _rate(one.rate_hz, measured=one.measured_times),
                f"{one.episodes:,}",
                f"{one.n:,}",
                bytes_text(one.bytes),
            )
            for one in numbers.streams
        ],
    )


def _rate(rate: Range | None, *, measured: bool) -> str:
    if rate is None:
        return ""
    return f"{_range(rate, 'Hz')}{'' if measured else ' (stated)'}"


def _range(values: Range, unit: str) -> str:
    low, middle, high = (f"{value:.3g}" for value in (values.min, values.median, values.max))
    return f"{middle} {unit}" if low == high else f"{middle} {unit} ({low} to {high})"


def _making(numbers: Statistics, facts: Facts) -> list[str]:
    rows = [
        (kind, f"{tool} {version}", converter, f"{count:,}")
        for (kind, tool, version, converter), count in facts.sources.items()
    ]
    lines = table(("Episodes were", "By", "Converter", "Episodes:"), rows)
    if facts.steps:
        lines += ["What was lost on the way, and where:", ""]
        lines += listed(
            f"{told_step(step)} – {amount(count, 'episode')}" for step, count in facts.steps.items()
        )
    elif numbers.episodes:
        lines += ["No step at which anything was lost is on record.", ""]
    return _section("How it was made", lines)


def _sensors(facts: Facts) -> list[str]:
    lines = table(
        ("Stream", "Sensor", "Stamped at", "Episodes:"),
        [(one.name, one.sensor, one.stamped, f"{n:,}") for one, n in facts.streams.items()],
    )
    lines += table(
        ("Device", "Gripper or hand", "Episodes:"),
        [(device, hand, f"{count:,}") for (device, hand), count in facts.devices.items()],
    )
    lines += table(
        ("Image without contact of", "How it was had", "Episodes:"),
        [(name, how or "there is none", f"{n:,}") for (name, how), n in facts.references.items()],
    )
    lines += table(
        ("Calibration", "Method", "Episodes:"),
        [(name, how, f"{count:,}") for (name, how), count in facts.calibration.items()],
    )
    return _section("Sensors and calibration", lines)


def _splits(dataset: Dataset) -> list[str]:
    rows = [
        (name, part, split.level, f"{len(ids):,}")
        for name, split in dataset.splits.items()
        for part, ids in split.lists.items()
    ]
    about = ["Episodes of the same thing (see *kept together*) are in one list.", ""]
    lines = table(("Split", "List", "Kept together", "Episodes:"), rows)
    return _section("Splits", [*about, *lines] if lines else [])


def _quality(numbers: Statistics, facts: Facts, findings: Sequence[Finding] | None) -> list[str]:
    lines: list[str] = []
    if numbers.active.ratio is not None:
        lines += [
            f"{numbers.active.ratio:.0%} of the tactile moments are contact. "
            f"At {_share(numbers.usable.ratio)} of the moments an episode has all of its streams.",
            "",
        ]
    success = {word: count for word, count in numbers.content.success.items() if word}
    if success:
        told = ", ".join(f"{word} {count:,}" for word, count in success.items())
        lines += [f"The task was done: {told}.", ""]
    lines += table(
        ("Stream", "Jitter:", "Gaps:", "Longest gap:", "Counted as lost:"),
        [
            (
                one.name,
                f"{1e3 * one.jitter_s.median:.2g} ms" if one.jitter_s else "",
                f"{one.gaps:,}",
                f"{one.longest_gap_s:.3g} s" if one.gaps else "",
                f"{sum(one.lost.values()):,}" if one.lost else "",
            )
            for one in numbers.streams
            if one.measured_times
        ],
    )
    notes: Counter[str] = Counter()
    for (code, _), count in facts.notes.items():
        notes[code] += count
    lines += table(("Note on quality", "Episodes:"), sorted(notes.items()))
    return _section("Quality", lines + _findings(findings))


def _findings(findings: Sequence[Finding] | None) -> list[str]:
    if findings is None:
        return []
    if not findings:
        return ["`exumi validate` found nothing to complain about.", ""]
    counts: Counter[tuple[str, str]] = Counter()
    for one in findings:
        counts[one.severity, one.code] += one.count
    first = {(one.severity, one.code): one.message for one in reversed(findings)}
    order = {"error": 0, "warning": 1, "info": 2}
    rows = [
        (severity, code, f"{count:,}", first[severity, code])
        for (severity, code), count in sorted(
            counts.items(), key=lambda item: (order.get(item[0][0], 3), item[0][1])
        )
    ]
    said = "What `exumi validate` found:"
    return [said, "", *table(("", "Rule", "Times:", "Such as"), rows)]


def _share(ratio: float | None) -> str:
    return "none" if ratio is None else f"{ratio:.0%}"


def _labels(numbers: Statistics, facts: Facts) -> list[str]:
    measured = {one.property: one for one in numbers.labels}
    rows = []
    for label, count in sorted(facts.labels.items(), key=lambda item: (item[0].property, -item[1])):
        values = measured[label.property]
        scale = "{:g} to {:g}".format(*label.scale) if label.scale else ""
        told = _range(values.numbers, "") if values.numbers else _most_frequent(values.words)
        by = "people" if label.provenance == "human" else "a model"
        raters = f"{label.raters}" if label.raters else ""
        rows.append((label.property, told, scale, by, raters, label.origin, f"{count:,}"))
    told_so = "Values (of numbers: median, and lowest to highest)"
    head = ("Property", told_so, "Scale", "By", "Raters:", "Taken from", "Episodes:")
    return _section("Labels", table(head, rows))


def _most_frequent(words: Mapping[str, int]) -> str:
    """Name the first of words that are in order of their number, and count the others."""
    shown = [
        word if len(word) <= _LONGEST_WORD else f"{word[: _LONGEST_WORD - 1]}…"
        for word in list(words)[:_MOST_WORDS]
    ]
    more = len(words) - len(shown)
    return ", ".join(shown) + (f", and {more:,} more" if more else "")


def _licence(dataset: Dataset, facts: Facts) -> list[str]:
    licence = dataset.metadata.licence
    if licence == UNKNOWN_LICENCE:
        lines = ["It is not known under which licence the dataset may be used.", ""]
    else:
        lines = [f"`{licence.replace('`', '')}` (SPDX).", ""]
    others = Counter({name: n for name, n in facts.licences.items() if name != licence})
    for word in NO_LICENCE:
        if word in others:
            lines += [
                f"`{word}` is no licence, and {others.pop(word):,} of {len(dataset):,} episodes "
                "say it: nobody may use these.",
                "",
            ]
    if others:
        lines += [
            "Episodes with a licence of their own, which holds for them: "
            f"{others.total():,} of {len(dataset):,}.",
            "",
        ]
        lines += table(("Licence", "Episodes:"), others.items())
    return _section("Licence", lines)


def _citation(dataset: Dataset, about: Edition) -> list[str]:
    lines = []
    if dataset.metadata.citation and not dataset.metadata.citation.strip().startswith("@"):
        lines += [plain(dataset.metadata.citation), ""]
    return _section("Citation", [*lines, *code_block(bibtex_of(dataset.metadata, about), "bibtex")])


def _loading(dataset: Dataset, repository: str | None) -> list[str]:
    folder = "".join(c if c.isalnum() or c in "-_." else "-" for c in dataset.metadata.name)
    lines = ["import exumi_data", ""]
    if repository is not None:
        lines = ["import exumi_data", "from huggingface_hub import snapshot_download", ""]
        lines += [f"snapshot_download({repository!r}, repo_type='dataset', local_dir={folder!r})"]
    lines += [
        f'dataset = exumi_data.open("{folder}")  # the folder of this file',
        "print(len(dataset), dataset.catalog.schema.names)",
        "",
        "episode = dataset[0]",
        "for name, stream in episode.streams.items():",
        "    print(name, stream.kind, len(stream), stream.time[:3])  # nanoseconds, int64",
        "    if stream.is_image:",
        "        print(stream.frames[0].shape)  # (H, W, C) uint8",
    ]
    about = (
        "Each episode is a Zarr v3 group, in the exUMI Episode format, which any Zarr v3 library "
        "opens. With the package `exumi-data`:"
    )
    return _section("Loading", [about, "", *code_block("\n".join(lines), "python")])
