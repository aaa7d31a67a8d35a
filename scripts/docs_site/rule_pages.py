"""The rule catalogue: one page a rule, and an index by section and severity.

What and why come from the rule tables, the sentence from the standard's text, the example from the
conformance corpus with what our validator says about it.
"""

import re
import textwrap
from collections.abc import Callable
from functools import cache

from corpus_examples import Example, examples
from links import ROOT, rewritten

from exumi_data.standard import Rule, rules
from exumi_data.standard.rule_table import RULE_FILES
from exumi_data.standard.toml_data import read_toml

__all__ = ["SECTIONS", "rule_pages", "sentence"]

SECTIONS = {
    "documents": "Documents",
    "files": "Files and packing",
    "samples": "Samples",
    "frames": "Frames and videos",
    "derived": "Derived arrays",
    "dataset": "Datasets",
    "manifest": "Manifests",
    "timing": "Quality: times and clocks",
    "sync": "Quality: streams against each other",
    "touch": "Quality: touch",
    "motion": "Quality: motion and calibration",
    "labels": "Quality: labels",
}
"""Heading of each file of rules."""

_LEVELS = {
    "document": "the JSON documents alone",
    "hierarchy": "names, shapes and codecs",
    "arrays": "the low-dimensional arrays",
    "data": "every byte and every frame",
}
_MEANS = {
    "error": "breaks a MUST: the data is not valid",
    "warning": "breaks a SHOULD: the data is valid, and something is probably wrong",
    "info": "neither MUST nor SHOULD: it is said, and not judged",
}


def by_section() -> dict[str, list[Rule]]:
    """Return the rules by the file that they stand in, in the order of the standard."""
    table = rules()
    return {
        name: [table[entry["id"]] for entry in read_toml(f"rules/{name}.toml")["rule"]]
        for name in RULE_FILES
    }


def rule_pages() -> dict[str, str]:
    """Return the pages by their place on the site."""
    cases = examples()
    found = {"rules/index.md": _index()}
    for name, section in by_section().items():
        for rule in section:
            found[f"rules/{rule.id}.md"] = _page(rule, SECTIONS[name], cases[rule.id])
    return found


def sentence(rule: Rule) -> str:
    """Return the sentence of the standard that a rule is, as Markdown for its page.

    Raises
    ------
    ValueError
        If the text has no such sentence.
    """
    path = f"spec/1.0/{rule.anchor.partition('#')[0]}"
    paragraph = next((p for p in _paragraphs(path) if f'<a id="{rule.id}"></a>' in p), None)
    if paragraph is None:
        msg = f"{path} has no sentence with {rule.id}"
        raise ValueError(msg)
    text = re.sub(r'<a id="[^"]+"></a>', "", paragraph).removeprefix("- ")
    # What leads to a place of the same text leads to that text.
    text = text.replace("](#", f"]({path.rpartition('/')[2]}#")
    text = rewritten(" ".join(text.split()), path, f"rules/{rule.id}.md")
    return re.sub(r" ?\(?\*\*\[([\w-]+)\]\*\*\)?", _mark(rule), text)


def _mark(rule: Rule) -> Callable[[re.Match[str]], str]:
    """Return how ids within a sentence are shown: other rules' as links, the rule's own not."""

    def one(match: re.Match[str]) -> str:
        other = match[1]
        return "" if other == rule.id else f" ([{other}]({other}.md))"

    return one


@cache
def _paragraphs(path: str) -> list[str]:
    """Return the paragraphs and the items of lists of a text."""
    text = (ROOT / path).read_text("utf-8")
    return re.split(r"\n\s*\n|\n(?=- )", text)


def _heading_of(rule: Rule) -> str:
    """Return a link to the section of the standard in which a rule stands."""
    name = rule.anchor.partition("#")[0]
    text = (ROOT / "spec" / "1.0" / name).read_text("utf-8")
    before = text[: text.index(f'<a id="{rule.id}"></a>')]
    heading = re.findall(r"^#{1,3} (.+)$", before, re.MULTILINE)[-1]
    return f"[{heading}](../spec/{name}#{rule.id})"


def _page(rule: Rule, section: str, cases: list[Example]) -> str:
    parts = [
        f"---\ntitle: {rule.id}\n---\n",
        f"# {rule.id}: {rule.title}\n",
        f'<span class="severity {rule.severity}">{rule.severity}</span> '
        f"{_MEANS[rule.severity].partition(':')[0]} · judged at level "
        f"[`{rule.level}`](../validating.md#levels) ({_LEVELS[rule.level]}) · since "
        f"{rule.since} · [{section}](index.md#{_slug(section)})\n",
        "## What\n",
        f"> {sentence(rule)}\n",
        f"In the standard: {_heading_of(rule)}.\n",
        _limits(rule),
        "## Why\n",
        f"{rule.why}\n",
        "## An example that breaks it\n",
        _example(cases[0]),
        _others(cases[1:]),
        "## How to mend it\n",
        f"{_ended(rule.suggestion)}\n",
        f"{rule.mend}\n" if rule.mend else "",
        _not_for_you(rule),
    ]
    return "\n".join(part for part in parts if part)


def _example(case: Example) -> str:
    link = f"`spec/conformance/1.0/invalid/{case.name}`"
    problem = case.problem
    place = problem.location
    where = "/".join(part for part in (place.episode, place.path) if part) or "."
    at = place.pointer or ("" if place.index is None else f"[{place.index}]")
    told = f"{problem.severity:<8}{problem.code}  {where} {at}".rstrip()
    said = textwrap.fill(problem.message, 70, initial_indent=" " * 8, subsequent_indent=" " * 8)
    text = f"{case.about} This is the case {link} of the conformance corpus.\n\n"
    if case.shown is not None:
        target = f"`{where}`" + (f" at `{place.pointer}`" if place.pointer else "")
        text += f"{target} holds\n\n```{case.language}\n{case.shown}\n```\n\n"
    text += "and `exumi validate` says" if case.shown is not None else "`exumi validate` says"
    return f"{text}\n\n```text\n{told}\n{said}\n```\n"


def _others(cases: list[Example]) -> str:
    if not cases:
        return ""
    head = "The corpus has other ways to break it:\n\n| case | | what is said |\n|---|---|---|\n"
    rows = [f"| `{c.name}` | {c.about} | {_plain(c.problem.message)} |" for c in cases]
    return head + "\n".join(rows) + "\n"


def _limits(rule: Rule) -> str:
    if not rule.limits:
        return ""
    head = "| limit | value |\n|---|---|\n"
    return head + "\n".join(f"| `{k}` | {v:g} |" for k, v in rule.limits.items()) + "\n"


def _not_for_you(rule: Rule) -> str:
    limits = " or other `limits`" if rule.limits else ""
    link = "[Your own judgement](../validating.md#your-own-judgement)"
    stays = (
        " A MUST that you relax stays one: such data does not conform to the standard."
        if rule.severity == "error"
        else ""
    )
    return (
        f"Where the rule is not for your data, give `{rule.id}` another severity{limits} in "
        f"`exumi.toml`, or suppress it for some episodes, with the reason: {link}.{stays}\n"
    )


def _index() -> str:
    table = rules().values()
    counts = {s: sum(rule.severity == s for rule in table) for s in _MEANS}
    lines = [
        "# Rules\n",
        f"exUMI 1.0 has {len(table)} rules. Their ids are the codes that `exumi validate` reports.",
        "Each has a page: what the standard asks for, why, an example that breaks it, and how to",
        "mend it.\n",
        "| severity | | rules |",
        "|---|---|---|",
        *(
            f'| <span class="severity {name}">{name}</span> | {_MEANS[name]} | {counts[name]} |'
            for name in _MEANS
        ),
        "",
    ]
    for name, section in by_section().items():
        lines += [f"## {SECTIONS[name]}\n", "| rule | severity | level | what holds |"]
        lines += ["|---|---|---|---|", *map(_row, section), ""]
    for severity, means in _MEANS.items():
        links = [f"[{rule.id}]({rule.id}.md)" for rule in table if rule.severity == severity]
        lines += [f"## All of severity {severity}\n", f"{_ended(means[0].upper() + means[1:])}\n"]
        lines += [" · ".join(links), ""]
    table_page = (ROOT / "spec" / "1.0" / "rules.md").read_text("utf-8")
    lines.append(table_page[table_page.index("## Places") :])
    return "\n".join(lines)


def _row(rule: Rule) -> str:
    badge = f'<span class="severity {rule.severity}">{rule.severity}</span>'
    return f"| [{rule.id}]({rule.id}.md) | {badge} | `{rule.level}` | {_cell(rule.title)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _plain(text: str) -> str:
    """Return a program's words for a cell, whatever signs of Markdown they hold."""
    return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", text).replace("\n", " ")


def _ended(text: str) -> str:
    return text if text.endswith((".", "?")) else f"{text}."


def _slug(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
