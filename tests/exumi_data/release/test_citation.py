import re
from typing import Any

import pytest

from exumi_data.errors import UsageError
from exumi_data.model import DatasetMetadata
from exumi_data.release.citation import Edition, bibtex_of, cff_of

yaml = pytest.importorskip("yaml")

EDITION = Edition(version="1.0.0", published="2026-03-01", url="https://data.example/set")


def metadata(**changes: Any) -> DatasetMetadata:
    values: dict[str, Any] = {"name": "Touch: clips & more", "licence": "CC-BY-4.0"}
    return DatasetMetadata(**{**values, **changes})


def test_a_citation_file() -> None:
    authors = ["Ada B. Lovelace", "Noether, Emmy", "The Touch Lab", "Plato <plato@academy.example>"]
    text = cff_of(metadata(authors=authors, description="Clips of a gel."), EDITION)
    assert yaml.safe_load(text or "") == {
        "cff-version": "1.2.0",
        "message": "If you use this dataset, please cite it.",
        "type": "dataset",
        "title": "Touch: clips & more",
        "abstract": "Clips of a gel.",
        "version": "1.0.0",
        # A day without quotes would be a date, not the string that the format asks for.
        "date-released": "2026-03-01",
        "url": "https://data.example/set",
        "license": "CC-BY-4.0",
        "authors": [
            {"given-names": "Ada B.", "family-names": "Lovelace"},
            {"family-names": "Noether", "given-names": "Emmy"},
            {"name": "The Touch Lab"},
            {"name": "Plato", "email": "plato@academy.example"},
        ],
    }


def test_that_nothing_is_made_up() -> None:
    assert cff_of(metadata()) is None
    text = cff_of(metadata(authors=["Plato"], licence="NOASSERTION")) or ""
    assert set(yaml.safe_load(text)) == {"cff-version", "message", "type", "title", "authors"}
    assert "license" not in (cff_of(metadata(authors=["P"], licence="MIT OR Apache-2.0")) or "")


def test_a_text_that_is_not_what_yaml_takes_it_for() -> None:
    for name in ("yes", "1.0", "- a", "a: b # c", '"quoted"', "ünï 🤖\\n"):
        text = cff_of(metadata(name=name, authors=[name]))
        assert yaml.safe_load(text or "")["title"] == name


def test_bibtex_of_what_is_said() -> None:
    text = bibtex_of(
        metadata(authors=["Ada Lovelace", "The Touch Lab"], citation="See doi:10.1234/abc.5."),
        EDITION,
    )
    assert text == (
        "@misc{touch-clips-more,\n"
        "  title = {{Touch: clips \\& more}},\n"
        "  author = {Ada Lovelace and {The Touch Lab}},\n"
        "  year = {2026},\n"
        "  version = {1.0.0},\n"
        "  url = {https://data.example/set},\n"
        "  doi = {10.1234/abc.5},\n"
        "  note = {See doi:10.1234/abc.5.},\n"
        "}"
    )


def test_bibtex_of_its_own_and_of_little() -> None:
    own = "@inproceedings{x,\n title={T}\n}"
    assert bibtex_of(metadata(citation=f" {own}\n")) == own
    assert re.findall(r"(\w+) =", bibtex_of(metadata())) == ["title"]


@pytest.mark.parametrize("said", [{"published": "2026-13-01"}, {"url": "data.example"}])
def test_an_edition_that_is_none(said: dict[str, str]) -> None:
    with pytest.raises(UsageError):
        Edition(**said)


@pytest.mark.parametrize(
    ("licence", "said"),
    [
        ("CC-BY-4.0", {"license": "CC-BY-4.0"}),
        # The format has a list of its own, older than these.
        (
            "CDLA-Permissive-2.0",
            {"license-url": "https://spdx.org/licenses/CDLA-Permissive-2.0.html"},
        ),
        ("CC-BY-3.0-DE", {"license-url": "https://spdx.org/licenses/CC-BY-3.0-DE.html"}),
        ("MIT OR Apache-2.0", {}),
        ("NONE", {}),
    ],
)
def test_what_the_citation_format_knows_of_licences(licence: str, said: dict[str, str]) -> None:
    text = cff_of(DatasetMetadata(name="x", licence=licence, authors=["A. Person"]))
    assert text is not None
    read = yaml.safe_load(text)
    assert {key: value for key, value in read.items() if key.startswith("license")} == said


def test_what_the_citation_format_forbids() -> None:
    authors = ["Ada Lovelace <ada@localhost>", "", "Ada Lovelace", "y\x80\u2028"]
    made = DatasetMetadata(name="x\x7f", licence="MIT", authors=authors, citation="10.1234/a+b")
    read = yaml.safe_load(cff_of(made) or "")
    assert read["title"] == "x\x7f"
    assert read["authors"] == [
        {"family-names": "Lovelace", "given-names": "Ada"},
        {"name": "y\x80"},
    ]
    assert "doi" not in read
    assert cff_of(DatasetMetadata(name="x", licence="MIT", authors=[" "])) is None
