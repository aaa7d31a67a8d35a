"""The page says true things, escapes everything, stays small, and is the same every time."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

import exumi_data
from exumi_data.dataset import Dataset
from exumi_data.errors import UsageError
from exumi_data.stats import Unreadable, measure
from exumi_data.stats.html import Finding, Judgement, NotJudged, check_target, page_of, write_page
from exumi_data.stats.html.words import among_top
from exumi_data.stats.model import Labels
from tests.exumi_data.stats.html.conftest import HOSTILE, write_touch

GOOD = Judgement(
    standard="1.0",
    levels=("document", "data"),
    rules=9,
    episodes=3,
    samples=4,
    frames=5,
    findings=(),
)
WARNING = Finding(
    code="XX-001", severity="warning", count=2, message=HOSTILE, place=HOSTILE, suggestion=HOSTILE
)
ERROR = replace(WARNING, code="XX-002", severity="error", count=1)


class Outline(HTMLParser):
    """Tags, ids and the text of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.ids: list[str] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        self.ids += [value or "" for key, value in attrs if key == "id"]

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def page(touched: Dataset) -> str:
    return page_of(touched, measure(touched), judgement=GOOD, workers=1)


def verdict(page: str) -> str:
    found = re.search(r'id="verdict">(.*?)</div></div>', page, re.DOTALL)
    assert found is not None
    return re.sub(r"<[^>]*>", " ", found[1])


def test_hostile_names_are_text(page: str) -> None:
    outline = Outline(page)
    assert "script" not in outline.tags
    assert HOSTILE in outline.text
    assert not [key for key, _ in outline.attributes if key.startswith("on")]
    assert not [v for key, v in outline.attributes if key in ("src", "href")
                and not (v or "").startswith(("data:image/jpeg;base64,", "#"))]  # fmt: skip
    assert len(outline.ids) == len(set(outline.ids))


def test_every_chart_has_words_for_those_who_cannot_see(page: str) -> None:
    charts = re.findall(r"<svg .*?</svg>", page, re.DOTALL)
    assert len(charts) > 12
    for chart in charts:
        assert re.search(r"<title>[^<]+</title><desc>[^<]+</desc>", chart), chart[:200]
    assert all(re.search(r'alt="[^"]+"', image) for image in re.findall(r"<img [^>]*>", page))
    figures = re.findall(r'<figure class="card.*?</figure>', page, re.DOTALL)
    assert all(re.search(r'<p class="takeaway">[^<]+\.</p>', figure) for figure in figures)


def test_the_same_data_gives_the_same_bytes(touched: Dataset, page: str) -> None:
    assert page_of(touched, measure(touched), judgement=GOOD, workers=2) == page


def test_the_page_says_what_was_measured(page: str) -> None:
    text = Outline(page).text
    assert "3 play episodes of 1 object, 2.10 s, with tactile images" in text
    assert "50.0 %" in text  # of the moments are in contact
    assert "100 % of the tactile frames" in text or "of frames are in contact" in text
    assert "All episodes are simulated" in text
    assert "30 ± 2 ms" in text
    assert "Nine in ten samples lie between 0 and 80 mm. 3 samples without a valid" in text
    assert "Poses of tcp in world fill a box of 30 × 0 × 0 cm. 3 samples without" in text
    assert "missing: taxels, sound" in text


@pytest.mark.parametrize(
    ("judgement", "words"),
    [
        (None, "Not checked"),
        (GOOD, "Valid  by exUMI 1.0, without a warning"),
        (replace(GOOD, findings=(WARNING,)), "Valid, with 2 warnings"),
        (replace(GOOD, findings=(ERROR, WARNING)), "Not valid: 1 error"),
        (replace(GOOD, unchecked=(NotJudged("a", "b", 1),)), "Not fully checked"),
        (replace(GOOD, levels=("document", "arrays")), "what frames show was not judged"),
    ],
)
def test_the_verdict(touched: Dataset, judgement: Judgement | None, words: str) -> None:
    text = page_of(touched[:1], measure(touched[:1]), judgement=judgement, workers=1)
    assert words in verdict(text)
    if judgement is not None and judgement.findings:
        assert "XX-001" in Outline(text).text


def test_what_cannot_be_read_forbids_a_good_verdict(touched: Dataset) -> None:
    statistics = measure(touched)
    lost = Unreadable(f"{touched.path}/x", f"{touched.path}/x: damaged")
    page = page_of(touched, replace(statistics, unreadable=[lost]), judgement=GOOD, workers=1)
    assert "not readable as a whole" in verdict(page)
    assert "x: damaged" in page
    assert touched.path not in page  # nothing of the machine that it was made on


def test_thousands_of_names_are_summed_up(touched: Dataset) -> None:
    statistics = measure(touched)
    many = {f"{HOSTILE} {n} {'x' * 500}": 2 for n in range(5000)}
    labels = [
        Labels(property=f"p{n}", episodes=3, missing=0, numbers=None, scales=[], words=many,
               provenance={"human": 3})
        for n in range(200)
    ]  # fmt: skip
    crowded = replace(
        statistics,
        labels=labels,
        content=replace(statistics.content, tasks=many, objects=many, quality=many),
    )
    page = page_of(touched, crowded, judgement=GOOD, workers=1)
    assert len(page) < 400_000
    text = Outline(page).text
    assert "4,992 more" in text
    assert "188 more properties" in text


@pytest.mark.parametrize(
    ("episodes", "said"),
    [
        ({"a": 5, "b": 4, "c": 3, "d": 3, "": 9}, ", among the 2 with most episodes"),
        ({"a": 5, "b": 4, "c": 4, "d": 3}, ", among the 2 shown"),
        ({"a": 5, "b": 4, "c": 4, "": 9}, ""),
    ],
)
def test_which_groups_are_shown(episodes: dict[str, int], said: str) -> None:
    assert among_top(episodes, 2) == said


def test_a_page_of_one_episode(touched: Dataset) -> None:
    episode = touched[0]
    text = Outline(page_of(episode, measure(episode), judgement=GOOD)).text
    assert "One play episode of 1 object, 700.0 ms" in text
    assert "time (s)" in text
    assert "nothing to tell apart" in text  # rather than a heading with nothing below


def test_an_empty_dataset(touched: Dataset) -> None:
    nothing = touched.select(ids=[])
    text = Outline(page_of(nothing, measure(nothing))).text
    assert "No episodes." in text
    assert "It holds no episode yet. Episodes come from exumi record" in text
    assert "The dataset is empty: it holds no episode." in text
    assert "Nothing to remark" not in text
    assert "No tactile images" not in text  # rather than a page of cards about what is not there


def test_targets(tmp_path: Path, touched: Dataset) -> None:
    data = write_touch(tmp_path, 3)
    with pytest.raises(UsageError, match="inside the data"):
        check_target(data / "page.html")
    other = tmp_path / "notes.html"
    other.write_text("mine")
    with pytest.raises(UsageError, match="no page of exumi stats"):
        check_target(other)
    with pytest.raises(UsageError, match="no page of exumi stats"):
        check_target(tmp_path)
    episode = exumi_data.open(data)
    assert isinstance(episode, exumi_data.Episode)
    file = tmp_path / "new" / "page.html"
    check_target(file)
    size = write_page(file, page_of(episode, measure(episode)))
    assert file.stat().st_size == size
    check_target(file)  # a page may take the place of a page
