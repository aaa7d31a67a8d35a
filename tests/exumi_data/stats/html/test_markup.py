"""Whatever stands in data, the page stays what it is."""

from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.stats.html.markup import Html, element, fitted, join, shortened, text


class Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.data = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.data += data


@given(st.text())
def test_any_text_comes_back_as_text_and_attribute(value: str) -> None:
    reader = Reader()
    reader.feed(element("p", value, title=value))
    assert [tag for tag, _ in reader.tags] == ["p"]
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in value)
    assert reader.data == shown
    assert reader.tags[0][1]["title"] == shown


@pytest.mark.parametrize("value", ["\x00", "\ud800", "\u202e", "\x1b[31m", "\n"])
def test_what_cannot_be_printed_is_shown_as_an_escape(value: str) -> None:
    written = text(value)
    assert value not in written
    assert "\\" in written
    written.encode()


def test_elements() -> None:
    assert element("b", "a<b", None, 3) == "<b>a&lt;b3</b>"
    assert element("img", alt='"', width=3) == '<img alt="&quot;" width="3">'
    assert element("rect", x=1.0, y=2.256) == '<rect x="1" y="2.26"/>'
    assert element("rect", element("title", "t")) == "<rect><title>t</title></rect>"
    assert element("input", checked=True, disabled=False, id=None) == "<input checked>"
    assert element("a", class_="x", aria_label="y") == '<a class="x" aria-label="y"></a>'
    assert join(Html("<b>"), "<b>") == "<b>&lt;b&gt;"


def test_long_texts_keep_both_ends() -> None:
    assert shortened("abcdefghij", 10) == "abcdefghij"
    assert shortened("abcdefghijk", 10) == "abcde…hijk"
    assert len(shortened("x" * 10_000, 37)) == 37


def test_names_are_cut_to_the_width_that_they_take() -> None:
    assert fitted("short", 20) == "short"
    assert fitted("a" * 30, 9) == "aaaa…aaaa"
    assert fitted("物" * 30, 9) == "物物…物物"
    assert fitted("\u200d" * 9, 9) == r"\u20…200d"  # as it is shown
