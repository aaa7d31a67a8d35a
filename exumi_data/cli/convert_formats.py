"""``exumi convert --list``: the formats, and what each keeps and loses."""

from collections.abc import Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any

from exumi_data.cli.options import Format
from exumi_data.cli.output import print_json, printable, result_console

__all__ = ["settings_of", "show"]


def settings_of(given: Sequence[str]) -> dict[str, str]:
    """Take ``--option NAME=VALUE`` apart.

    Parameters
    ----------
    given : sequence of str

    Raises
    ------
    UsageError
        One is not of that form, or is given twice.
    """
    from exumi_data.errors import UsageError

    settings: dict[str, str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise UsageError(f"Invalid option ({text})", fix="Write it as: --option NAME=VALUE")
        if name in settings:
            raise UsageError(f"the option {name!r} is given twice")
        settings[name] = value
    return settings


def show(name: str | None, *, output: Format) -> None:
    """Print all formats, or one.

    Parameters
    ----------
    name : str, optional
        Only the formats of this name.
    output : Format

    Raises
    ------
    UsageError
        There is no such format.
    """
    from exumi_data.errors import UsageError

    formats = list(_formats())
    if name is not None:
        known = list(dict.fromkeys(entry["name"] for entry in formats))
        formats = [entry for entry in formats if entry["name"] == name]
        if not formats:
            raise UsageError(f"Invalid format ({name}). Supported values are {', '.join(known)}")
    if output is Format.JSON:
        print_json(formats)
        return
    width = result_console().width
    for number, entry in enumerate(formats):
        if number:
            print()
        for line in _lines(entry):
            text = printable(line)
            print(fill(text, width, subsequent_indent="      ", break_on_hyphens=False))


def _lines(entry: Mapping[str, Any]) -> Iterator[str]:
    yield f"{entry['direction']} {entry['name']}: {entry['describes']}"
    for word in ("keeps", "loses"):
        for line in entry[word]:
            yield f"  {word} {line}"
    for option, line in entry["options"].items():
        yield f"  -o {option}=...  {line}"


def _formats() -> Iterator[dict[str, Any]]:
    from exumi_converters import converters, exporters
    from exumi_converters.format_options import describe_options

    for name, converter in converters().items():
        yield {
            "direction": "--from",
            "name": name,
            "version": converter.version,
            "describes": converter.describes,
            "keeps": list(converter.keeps),
            "loses": list(converter.loses),
            "options": describe_options(converter.options),
        }
    for name, exporter in exporters().items():
        yield {
            "direction": "--to",
            "name": name,
            "version": exporter.version,
            "describes": exporter.describes,
            "keeps": [*exporter.keeps, *_kept(exporter.loses)],
            "loses": [f"{facet}: {text}" for facet, text in exporter.loses.items()],
            "options": describe_options(exporter.options),
        }


def _kept(loses: Mapping[str, str]) -> Iterator[str]:
    from exumi_converters import FACETS

    return (f"{facet}: {text}" for facet, text in FACETS.items() if facet not in loses)
