"""Summaries as text for people."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from exumi_data.cli.output import plain, plain_table, print_table, size_text, time_text
from exumi_data.stats.summary import DatasetSummary, EpisodeSummary

if TYPE_CHECKING:
    from rich.console import Console
    from rich.tree import Tree

__all__ = ["print_dataset", "print_episode"]

_MOST_VALUES = 8
_LONGEST_VALUE = 60
_LONGEST_LIST = 6


def print_dataset(summary: DatasetSummary, console: "Console") -> None:
    """Print a dataset's summary.

    Parameters
    ----------
    summary : DatasetSummary
    console : rich.console.Console
    """
    meta = summary.metadata
    console.print(f"[bold]Dataset {plain(meta['name'])}[/]  [dim]{plain(summary.path)}[/]")
    if meta.get("description"):
        console.print(meta["description"], markup=False)
    console.print()
    facts = plain_table(("", "left"), ("", "left"), header=False)
    packed = f", {summary.packed:,} of them packed" if summary.packed else ""
    rows = {
        "episodes": f"{summary.episodes:,}{packed}",
        "recorded": f"{time_text(summary.duration_s)}, {size_text(summary.bytes)}",
        "format": f"{meta['format']} {meta['version']}",
        "licence": meta["licence"],
        "authors": ", ".join(meta.get("authors", [])),
        "citation": meta.get("citation", ""),
        "splits": ", ".join(meta.get("splits", [])),
        "made by": _made_by(meta.get("made_by")),
        "regimes": _counts(summary.regimes),
        "tasks": _counts(summary.tasks),
        "objects": _counts(summary.objects),
        "parts": _counts(summary.parts),
        "labels": _counts(summary.labels),
        "licences of episodes": _other_licences(summary),
        "quality notes": _counts(summary.quality),
        "fingerprint": summary.fingerprint[:16],
    }
    for name, value in rows.items():
        if value:
            facts.add_row(f"[bold]{name}[/]", plain(value, lines=True))
    print_table(facts, console)
    if summary.streams:
        console.print()
        print_table(_dataset_streams(summary), console)


def _dataset_streams(summary: DatasetSummary) -> Any:
    table = plain_table(
        ("stream", "left"),
        ("kind", "left"),
        ("stored", "left"),
        ("episodes", "right"),
        ("samples", "right"),
    )
    for row in summary.streams:
        stored = "+".join(row.encodings) or "array"
        table.add_row(f"[bold]{row.name}[/]", row.kind, stored, f"{row.episodes:,}", f"{row.n:,}")
    return table


def _other_licences(summary: DatasetSummary) -> str:
    """Return the licences of the episodes, where they are not all that of the dataset."""
    same = set(summary.licences) <= {summary.metadata["licence"]}
    return "" if same else _counts(summary.licences)


def _made_by(made_by: Mapping[str, Any] | None) -> str:
    if made_by is None:
        return ""
    text = f"{made_by['tool']} {made_by['tool_version']}"
    return f"{text}: {made_by['command']}" if made_by.get("command") else text


def _counts(counts: Mapping[str, int]) -> str:
    shown = list(counts.items())[:_MOST_VALUES]
    text = ", ".join(f"{value} ({count:,})" for value, count in shown)
    rest = len(counts) - len(shown)
    return f"{text}, and {rest:,} more" if rest else text


def print_episode(summary: EpisodeSummary, console: "Console") -> None:
    """Print an episode's summary: a tree of its metadata.

    Parameters
    ----------
    summary : EpisodeSummary
    console : rich.console.Console
    """
    from rich.tree import Tree

    meta = summary.metadata
    form = "one zip" if summary.packed else "a folder"
    tree = Tree(
        f"[bold]Episode {meta['id']}[/]  [dim]{form}, {size_text(summary.bytes)}, "
        f"{meta['format']} {meta['version']}, revision {meta.get('revision', 1)}[/]",
        guide_style="dim",
    )
    _add_task(tree, meta)
    streams = tree.add("[bold]streams[/]")
    for name, stream in meta.get("streams", {}).items():
        _add_stream(streams, name, stream, summary.samples[name], summary.derived or {})
    _add_mapping(tree, "calibration", meta.get("calibration"))
    _add_mapping(tree, "annotations", meta.get("annotations"))
    _add_source(tree, meta["source"])
    notes = meta.get("quality", [])
    if notes:
        branch = tree.add("[bold]quality[/]")
        for note in notes:
            where = f" ({note['stream']})" if note.get("stream") else ""
            branch.add(f"[yellow]{plain(note['code'])}[/]{where}: {plain(note['message'])}")
    console.print(tree)


def _add_task(tree: "Tree", meta: Mapping[str, Any]) -> None:
    task = meta["task"]
    line = f"[bold]task[/] {plain(task['name'])} [dim]({meta['regime']})[/]"
    if task.get("instruction"):
        line += f": {plain(task['instruction'])}"
    tree.add(line)
    for key in ("start", "success", "operator", "site", "device", "embodiment", "licence"):
        value = meta.get(key)
        if value is not None:
            tree.add(f"[bold]{key}[/] {_short(value)}")


def _add_stream(
    branch: "Tree",
    name: str,
    stream: Mapping[str, Any],
    samples: int,
    derived: Mapping[str, Any],
) -> None:
    images = stream.get("images")
    stored = ""
    if images:
        size = f"{images['width']}×{images['height']}×{images['channels']}"
        what = images.get("media_type") or ", ".join(_containers(images)) or "uint8"
        stored = f", {size}, {images['encoding']} ({what})"
    rate = f", {stream['nominal_rate']} Hz nominal" if stream.get("nominal_rate") else ""
    node = branch.add(
        f"[bold cyan]{name}[/] [dim]{stream['kind']}[/]: {samples:,} samples{plain(stored)}{rate}"
    )
    node.add(f"clock {_short(stream['clock'])}")
    node.add(f"arrays {', '.join(stream['arrays'])}")
    shown = {"kind", "clock", "arrays", "images", "nominal_rate"}
    for key, value in stream.items():
        if key not in shown and value is not None:
            node.add(f"{plain(key)} {_short(value)}")
    for key, item in derived.items():
        owner, _, array = key.partition("/")
        if owner == name:
            parameters = item.get("parameters", {})
            node.add(
                f"derived [italic]{array}[/] by {plain(item['algorithm'])} {_short(parameters)}"
            )


def _containers(images: Mapping[str, Any]) -> list[str]:
    return sorted({f"{f['codec']} in {f['media_type']}" for f in images.get("files", [])})


def _add_mapping(tree: "Tree", name: str, values: Mapping[str, Any] | None) -> None:
    if not values:
        return
    branch = tree.add(f"[bold]{name}[/]")
    for key, value in values.items():
        if value is not None:
            branch.add(f"{plain(key)} {_short(value)}")


def _add_source(tree: "Tree", source: Mapping[str, Any]) -> None:
    tool = plain(f"{source['tool']} {source['tool_version']}")
    branch = tree.add(f"[bold]source[/] {source['type']} by {tool}")
    for key in ("converter", "key", "settings", "parent_id", "parent_digest"):
        if source.get(key) is not None:
            branch.add(f"{key} {_short(source[key])}")
    for item in source.get("inputs") or []:
        size = f", {size_text(item['bytes'])}" if item.get("bytes") is not None else ""
        branch.add(f"from {plain(item['name'])}{size} [dim]sha-256 {item['sha256'][:16]}[/]")
    lossy = source.get("lossy")
    if lossy is None:
        branch.add("[dim]nothing is said about lossy steps[/]")
    elif not lossy:
        branch.add("no lossy step")
    for step in lossy or []:
        where = f" {step['stream']}" if step.get("stream") else ""
        by = f" [dim]by {plain(step['by'])}[/]" if step.get("by") else ""
        branch.add(f"[yellow]lossy[/]{where}: {plain(step['step'])}, {plain(step['detail'])}{by}")


def _short(value: Any) -> str:
    """Write a JSON value in a few words."""
    if isinstance(value, Mapping):
        parts = [f"[dim]{plain(k)}[/] {_short(v)}" for k, v in value.items() if v is not None]
        return ", ".join(parts)
    if isinstance(value, list):
        shown = ", ".join(_short(item) for item in value[:_LONGEST_LIST])
        rest = len(value) - _LONGEST_LIST
        return f"({shown}, and {rest} more)" if rest > 0 else f"({shown})"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    text = str(value)
    return plain(text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…")
