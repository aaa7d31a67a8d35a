"""What an episode is, as a page of text beside its data."""

import re
from collections.abc import Iterator

import rerun as rr

from exumi_data.episode import Episode
from exumi_data.view.log import Log
from exumi_data.view.names import ABOUT
from exumi_data.view.panels import Panel

__all__ = ["about_text", "log_about"]

_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>()#+\-!|~&])")
_LONGEST = 300


def log_about(log: Log, episode: Episode) -> None:
    """Log what an episode is.

    Parameters
    ----------
    log : Log
    episode : Episode
    """
    page = rr.TextDocument(about_text(episode), media_type=rr.MediaType.MARKDOWN)
    log.fixed(ABOUT, page)
    log.place(Panel("about", ABOUT, "About"))


def about_text(episode: Episode) -> str:
    """Return what an episode is, as Markdown; nothing in its metadata is taken as Markdown.

    Parameters
    ----------
    episode : Episode
    """
    lines = [f"# {_plain(episode.metadata.task.name)}", ""]
    lines += [f"- **{name}** {_plain(value)}" for name, value in _facts(episode)]
    lines += ["", "| stream | kind | rate, Hz | clock |", "|---|---|---|---|"]
    for name, stream in episode.streams.items():
        clock = stream.metadata.clock.stamp_point
        cells = (name, stream.kind, stream.metadata.nominal_rate or "", clock)
        lines.append("| " + " | ".join(_plain(cell) for cell in cells) + " |")
    for note in episode.metadata.quality:
        which = f"{note.stream}: " if note.stream else ""
        lines += ["", f"**{note.severity}** {_plain(which + note.message)}"]
    return "\n".join(lines)


def _facts(episode: Episode) -> Iterator[tuple[str, object]]:
    meta = episode.metadata
    said = meta.annotations
    yield "id", meta.id
    yield "regime", meta.regime
    facts = {
        "instruction": meta.task.instruction,
        "start": meta.start,
        "success": {True: "yes", False: "no", None: None}[meta.success],
        "object": said and (said.object or said.object_id),
        "part": said and (said.part or said.part_id),
        "procedure": said and said.procedure,
        "device": meta.device and meta.device.name,
        "embodiment": meta.embodiment and meta.embodiment.name,
        "site": meta.site,
    }
    for name, value in facts.items():
        if value:
            yield name, value
    for label in (said.labels if said else None) or []:
        judged = ", ".join(label.value) if isinstance(label.value, list) else label.value
        scale = f" ({label.scale[0]:g} to {label.scale[1]:g})" if label.scale else ""
        yield label.property, f"{judged}{scale}, by {label.provenance}"
    yield "licence", meta.licence
    yield "source", f"{meta.source.type} by {meta.source.tool} {meta.source.tool_version}"


def _plain(value: object) -> str:
    text = " ".join(str(value).split())
    shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
    return _MARKDOWN.sub(r"\\\1", shown)
