"""``CHANGELOG.md`` of a released dataset: what differs from the release before it, for people."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from exumi_data.release.changes import Changes, EpisodeChange, Kind
from exumi_data.release.markdown import amount, plain
from exumi_data.release.privacy import Removal
from exumi_data.release.privacy.documents import without_private_fields

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
    name: str,
    version: str,
    previous: str | None,
    changes: Changes | None,
    older: str | None,
    hidden: Removal | None = None,
) -> str:
    """Return the text of a changelog.

    What a field that may be private was, and is, is not told: a name that was taken out would stay
    here for good. So would one of the release before, where nothing is taken out of this one.

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
    hidden : Removal, optional
        The people of this release and of the one before whom it must not name, and the kinds that
        are taken out of the older text: that may have been written by hand.
    """
    out = hidden or Removal(frozenset())
    lines = [f"## {version}", ""]
    if changes is None or previous is None:
        lines.append("The first release.")
    else:
        said = list(change_lines(changes, hidden=out)) or ["Nothing changed in the data."]
        lines += [
            f"Compared with {previous}:",
            "",
            # Cleaned once more: keys and names of splits are no values.
            *(f"- {plain(_without_names(line, out), most=None)}" for line in said),
        ]
    entry = "\n".join(lines) + "\n"
    before = "" if older is None else older[older.find("\n## ") + 1 :] if "\n## " in older else ""
    before = out.cleaned(before)
    head = f"# Changes of {plain(name)}\n\n"
    return head + entry + (f"\n{before}" if before else "")


def change_lines(changes: Changes, *, hidden: Removal | None = None) -> Iterator[str]:
    """Say what differs, one line a kind of change.

    Parameters
    ----------
    changes : Changes
    hidden : Removal, optional
        Then what may be private is not told, and neither are the names that it has.
    """
    for kind, words in _KINDS:
        alike: dict[str, list[EpisodeChange]] = {}
        for one in changes.of(kind):
            alike.setdefault(
                _fields(one.fields, hidden) if kind == "relabelled" else "", []
            ).append(one)
        listed = list(alike.items())
        if len(listed) > _SHOWN:  # a line an episode would be no changelog
            listed.sort(key=lambda item: -len(item[1]))
        for fields, same in listed[:_SHOWN]:
            count = amount(len(same), "episode")
            yield f"{count} {words}{fields}: {_named([one.id for one in same])}"
        others = sorted(one.id for _, same in listed[_SHOWN:] for one in same)
        if others:
            yield f"{amount(len(others), 'episode')} {words}, in other ways: {_named(others)}"
    for split in changes.splits:
        if split.kind == "changed":
            many = amount(len(split.episodes), "episode")
            yield f"split {split.name}: {many} in another list: {_named(split.episodes)}"
        else:
            yield f"split {split.name} {split.kind}"
    for key, (before, after) in changes.document.items():
        yield f"{key}: {_value(key, before, hidden)}, now {_value(key, after, hidden)}"


def _without_names(line: str, hidden: Removal) -> str:
    return replace(hidden, kinds=frozenset(hidden.names.values())).cleaned(line)


def _fields(fields: Mapping[str, tuple[object, object]], hidden: Removal | None) -> str:
    said = [
        f"{key} {_value(key, old, hidden)}, now {_value(key, new, hidden)}"
        for key, (old, new) in fields.items()
    ]
    return f" ({'; '.join(said)})" if said else ""


def _value(key: str, value: object, hidden: Removal | None) -> str:
    if value is None:
        return "nothing"
    if hidden is not None:
        name = key.rpartition(".")[2]
        every = replace(hidden, kinds=frozenset())  # of whatever kind, also of those that are kept
        left = without_private_fields({name: value}, key, lambda *_, **__: True, every)
        if name not in left:
            return "something"
        value = left[name]
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _named(ids: Sequence[str]) -> str:
    more = f" and {len(ids) - _SHOWN} more" if len(ids) > _SHOWN else ""
    return ", ".join(ids[:_SHOWN]) + more
