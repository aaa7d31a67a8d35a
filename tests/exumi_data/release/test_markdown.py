"""What people wrote reads in a card as they wrote it, by the rules of CommonMark and YAML."""

import html
import re

import pytest

from exumi_data.release.markdown import listed, plain, table
from exumi_data.release.yaml_text import yaml_text

markdown_it = pytest.importorskip("markdown_it")
yaml = pytest.importorskip("yaml")

TEXTS = [
    "- a point",
    "-",
    "---",
    "- - -",
    "+ plus",
    "+1.5 N is pressed",
    "-3 degrees",
    "* star",
    "***",
    "# heading",
    "####### seven",
    "=====",
    "> quoted",
    "| a | b |",
    "1. first",
    "17) seventeenth",
    "2024. A year",
    "3.5 mm",
    "<b>bold</b> & <script>alert(1)</script>",
    "<!-- a comment -->",
    "<https://acme.example>",
    "[a link](https://acme.example) and ![a picture](x.png)",
    "[ref]: https://acme.example",
    "`code` and ```more```",
    "```",
    "~~~",
    "~~gone~~",
    "_a_ __b__ object_id a_b_c *d* **e**",
    "&lt; &amp; &#35;",
    "\\# \\\\ \\",
    "$x^2$ and $$y$$",
    ":--- | ---:",
    "{#id .class}",
    "hard break \\",
    "a\tb",
]


def shown(markdown: str) -> tuple[str, set[str]]:
    made = markdown_it.MarkdownIt("gfm-like", {"linkify": False, "html": True}).render(markdown)
    tags = set(re.findall(r"<(/?\w+)", made))
    return html.unescape(re.sub(r"<[^>]*>", "", made)).strip(), {
        one for one in tags if one[0] != "/"
    }


@pytest.mark.parametrize("text", TEXTS)
def test_text_is_text_wherever_it_stands(text: str) -> None:
    said = " ".join(text.split())
    assert shown(plain(text)) == (said, {"p"})
    assert shown(f"Before it.\n\n{plain(text)}\n\nAfter it.")[0].split("\n")[1] == said
    assert shown(f"# {plain(text)}") == (said, {"h1"})
    assert shown("\n".join(listed([text]))) == (said, {"ul", "li"})
    found, tags = shown("\n".join(table(("A",), [(text,)])))
    assert (found.split()[0], " ".join(found.split()[1:])) == ("A", said)
    assert tags == {"table", "thead", "tr", "th", "tbody", "td"}


def test_what_is_long_is_cut_only_where_it_is_said() -> None:
    assert len(plain("x" * 500)) == 400
    assert plain("x" * 500, most=None) == "x" * 500


@pytest.mark.parametrize(
    "text",
    [
        "a: b",
        "- x",
        "'",
        '"\\',
        "#",
        "\x7f\x80\x85\u2028\ufeff",
        "\U000e0001😀",
        "né",
        "\ud800",
        "@%`!&*",
    ],
)
def test_scalars_of_yaml(text: str) -> None:
    read = yaml.safe_load(f"key: {yaml_text(text)}")["key"]
    assert read == text.replace("\ud800", "\ufffd")
