"""The text, the rules and their ids say the same."""

import re
from pathlib import Path

import pytest

from exumi_data.standard import rules

NORMATIVE = ("episode.md", "dataset.md", "quality.md")
ID = re.compile(r"\b([A-Z]+-\d{3})\b")
ANCHOR = re.compile(r'<a id="([A-Z]+-\d{3})"></a>\*\*\[\1\]\*\*')
WORDS = re.compile(r"\b(MUST|SHOULD|SHALL|REQUIRED TO)\b")


def markdown(spec: Path) -> list[Path]:
    """The pages of the standard, without those of packages that are installed in it."""
    return [page for page in sorted(spec.rglob("*.md")) if "node_modules" not in page.parts]


def prose(text: str) -> str:
    """A page without code, rendered tables and headings."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!-- begin .*?<!-- end \w+ -->", "", text, flags=re.DOTALL)
    return re.sub(r"^#.*$", "", text, flags=re.MULTILINE)


def sentences(text: str) -> list[str]:
    """The sentences of a page: a list's item or a paragraph is cut at full stops."""
    blocks = re.split(r"\n\s*\n|\n(?=- )", prose(text))
    joined = (" ".join(block.split()) for block in blocks)
    return [part for block in joined for part in re.split(r"(?<=[.:])\s+(?=[A-Z`*_])", block)]


@pytest.fixture(scope="module")
def pages(spec: Path) -> dict[str, str]:
    return {name: (spec / "1.0" / name).read_text("utf-8") for name in NORMATIVE}


def test_every_demand_carries_a_rule(pages: dict[str, str]) -> None:
    demands = [
        (name, sentence)
        for name, text in pages.items()
        for sentence in sentences(text)
        if WORDS.search(sentence) and "sentence with MUST or SHOULD" not in sentence
    ]
    assert len(demands) > 100
    assert [demand for demand in demands if not ANCHOR.search(demand[1])] == []


def test_a_demand_without_a_rule_is_found() -> None:
    found = [s for s in sentences("It is so. It MUST hold. It is.") if WORDS.search(s)]
    assert found == ["It MUST hold."]


NOTHING = re.compile(
    r"^(?:- )?(?:[^,:]*[,:] )?(?:no|nothing|none|neither|nobody)\b(?! less| more).*(MUST|SHOULD)\b",
    re.IGNORECASE,
)
"""What forbids nothing by RFC 2119, which says that something MUST NOT be."""


def test_what_is_forbidden_must_not_be(pages: dict[str, str]) -> None:
    found = [s for text in pages.values() for s in sentences(text) if NOTHING.search(s)]
    assert found == []


@pytest.mark.parametrize(
    ("sentence", "forbids"),
    [
        ("- No name MUST stand twice.", False),
        ("Of two, no less than one SHOULD be there.", True),
        ("In a zip, no name SHOULD stand twice.", False),
        ("There MUST be no entries for folders.", True),
        ("A name MUST NOT stand twice.", True),
        ("Notes MUST be short.", True),
    ],
)
def test_a_demand_that_forbids_nothing_is_found(sentence: str, forbids: bool) -> None:
    assert (NOTHING.search(sentence) is None) == forbids


def test_must_is_an_error_and_should_a_warning(pages: dict[str, str]) -> None:
    severity = {"MUST": "error", "SHOULD": "warning"}
    judged = set()
    for text in pages.values():
        for sentence in sentences(text):
            ids = ANCHOR.findall(sentence)
            words = set(WORDS.findall(sentence))
            if ids and words:
                assert len(words) == 1, sentence
                (word,) = words
                found = {rules()[code].severity for code in ids}
                assert found == {severity[word]}, sentence
                judged.update(ids)
    infos = {code for code, rule in rules().items() if rule.severity == "info"}
    assert {code for code in rules() if code not in judged} <= infos


def test_every_rule_stands_where_its_anchor_says(pages: dict[str, str]) -> None:
    for rule in rules().values():
        page, _, anchor = rule.anchor.partition("#")
        assert anchor == rule.id
        assert ANCHOR.findall(pages[page]).count(rule.id) == 1, rule.id


def test_no_id_is_unknown(spec: Path) -> None:
    pages = markdown(spec)
    assert len(pages) > 5
    for page in pages:
        prefixes = {rule.group for rule in rules().values()}
        named = {i for i in ID.findall(page.read_text("utf-8")) if i.partition("-")[0] in prefixes}
        assert named <= set(rules()), page.name


def test_links_lead_somewhere(spec: Path) -> None:
    count = 0
    for page in markdown(spec):
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
            if not target.startswith("http"):
                count += 1
                assert (page.parent / target).exists(), f"{page.name}: {target}"
    assert count > 10


def test_no_question_is_answered_twice(spec: Path) -> None:
    asked = re.findall(r"^\*\*(.+\?)\*\*", (spec / "1.0/notes.md").read_text("utf-8"), re.MULTILINE)
    assert len(asked) > 15
    assert len(asked) == len(set(asked))
