"""``CHANGELOG.md`` of a released dataset: what differs from the release before it, for people."""

import json
from collections.abc import Iterator, Mapping, Sequence

from exumi_data.release.changes import Changes, EpisodeChange, Kind

__all__ = ["CHANGELOG_NAME", "change_lines", "changelog_of"]

CHANGELOG_NAME = "CHANGELOG.md"

_KINDS: tuple[tuple[Kind, str], ...] = (
    ("changed", "changed, other samples"),
    ("removed", "removed"),
    ("relabelled", "relabelled, the same samples"),
    ("added", "added"),
    ("reserialised", "written anew, the same recording"),
)
_SHOWN = 20
_LONGEST = 120


def changelog_of(
    name: str, version: str, previous: str | None, changes: Changes | None, older: str | None
) -> str:
    """Return the text of a changelog.

    Parameters
    ----------
    name : str
        Of the dataset.
    version : str
    previous : str or None
        The version before it.
    changes : Changes or None
        What differs from that; None of a first release.
    older : str or None
        The changelog of the release before.
    """
    lines = [f"## {version}", ""]
    if changes is None or previous is None:
        lines.append("The first release.")
    else:
        said = list(change_lines(changes)) or ["Nothing changed in the data."]
        lines += [f"Compared with {previous}:", "", *(f"- {line}" for line in said)]
    entry = "\n".join(lines) + "\n"
    before = "" if older is None else older[older.find("\n## ") + 1 :] if "\n## " in older else ""
    head = f"# Changes of {' '.join(name.split())}\n\n"
    return head + entry + (f"\n{before}" if before else "")


def change_lines(changes: Changes) -> Iterator[str]:
    """Say what differs, one line a kind of change.

    Parameters
    ----------
    changes : Changes
    """
    for kind, words in _KINDS:
        alike: dict[str, list[EpisodeChange]] = {}
        for one in changes.of(kind):
            alike.setdefault(_fields(one.fields) if kind == "relabelled" else "", []).append(one)
        for fields, same in alike.items():
            count = f"{len(same)} episode{'s' if len(same) > 1 else ''} {words}"
            yield f"{count}{fields}: {_named([one.id for one in same])}"
    for split in changes.splits:
        if split.kind == "changed":
            many = len(split.episodes)
            yield f"split {split.name}: {many} episodes in another list: {_named(split.episodes)}"
        else:
            yield f"split {split.name} {split.kind}"
    for key, (before, after) in changes.document.items():
        yield f"{key}: {_value(before)}, now {_value(after)}"


def _fields(fields: Mapping[str, tuple[object, object]]) -> str:
    said = [f"{key} {_value(old)}, now {_value(new)}" for key, (old, new) in fields.items()]
    return f" ({'; '.join(said)})" if said else ""


def _value(value: object) -> str:
    if value is None:
        return "nothing"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _named(ids: Sequence[str]) -> str:
    more = f" and {len(ids) - _SHOWN} more" if len(ids) > _SHOWN else ""
    return ", ".join(ids[:_SHOWN]) + more
