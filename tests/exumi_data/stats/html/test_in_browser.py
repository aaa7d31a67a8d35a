"""The page in a real browser: nothing is loaded, nothing runs, nothing is too wide."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from exumi_data.dataset import Dataset
from exumi_data.stats import measure
from exumi_data.stats.html import Finding, Judgement, page_of, write_page
from tests.browser import Browser, open_browser
from tests.exumi_data.stats.html.conftest import HOSTILE

SECTIONS = [
    "overview", "content", "touch", "sheets", "timing", "motion", "labels", "findings", "origin",
]  # fmt: skip
GROUND = "getComputedStyle(document.body).backgroundColor"
TOO_WIDE = """[...document.querySelectorAll('body *')].filter(e => e.getClientRects().length
  && !e.closest('.unseen') && !e.closest('.theme')
  && e.getBoundingClientRect().right > innerWidth + 0.5).map(e => e.tagName + '.' + e.className)"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as found:
        yield found


@pytest.fixture(scope="module")
def page(touched: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    long = "".join(("spam", "x" * 300, HOSTILE))
    finding = Finding(
        code="XX-001", severity="warning", count=2, message=long, place=long, suggestion=long
    )
    judgement = Judgement(
        standard="1.0", levels=("data",), rules=1, episodes=3, samples=1, frames=1,
        findings=(finding,),
    )  # fmt: skip
    file = tmp_path_factory.mktemp("pages") / "page.html"
    write_page(file, page_of(touched, measure(touched), judgement=judgement, workers=1))
    return file


def test_nothing_is_loaded_and_nothing_runs(browser: Browser, page: Path) -> None:
    with browser.tab(page) as tab:
        assert tab.errors == []
        assert [url for url in tab.requests if not url.startswith("data:")] == [page.as_uri()]
        sections = tab.run("[...document.querySelectorAll('section')].map(s => s.id)")
        assert sections == SECTIONS
        assert tab.run("document.scripts.length") == 0
        assert tab.run("[...document.images].every(i => i.naturalWidth > 0)") is True
        assert tab.run("document.images.length") == 15
        assert tab.run(TOO_WIDE) == []


def test_the_policy_of_the_page_forbids_scripts_and_requests(browser: Browser, page: Path) -> None:
    """Were an element smuggled in after all, the browser would refuse it."""
    with browser.tab(page) as tab:
        tab.run(
            "document.body.insertAdjacentHTML('beforeend', "
            "'<img src=http://127.0.0.1:9/x onerror=window.hacked=1>')"
        )
        tab.run("new Promise(done => setTimeout(done, 200))")
        browser.listen(0.3)
        assert tab.run("window.hacked") is None
        assert any("Content Security Policy" in error for error in tab.errors)


def test_a_phone_has_no_horizontal_scroll(browser: Browser, page: Path) -> None:
    with browser.tab(page, (360, 740)) as tab:
        assert tab.run("document.documentElement.scrollWidth") == 360
        assert tab.run(TOO_WIDE) == []
        assert tab.run("parseFloat(getComputedStyle(document.body).fontSize)") >= 15


def test_dark_and_light(browser: Browser, page: Path) -> None:
    with browser.tab(page) as tab:
        light = tab.run(GROUND)
        tab.media(dark=True)
        dark = tab.run(GROUND)
        assert dark != light
        tab.run("document.querySelector('label[for=light]').click()")
        assert tab.run(GROUND) == light
        tab.media(dark=False)
        tab.run("document.querySelector('label[for=dark]').click()")
        assert tab.run(GROUND) == dark
        tab.run("document.querySelector('label[for=auto]').click()")
        assert tab.run(GROUND) == light


def test_paper_is_white_and_has_no_menu(browser: Browser, page: Path) -> None:
    with browser.tab(page, dark=True) as tab:
        tab.run("document.querySelector('label[for=dark]').click()")
        tab.media(dark=True, kind="print")
        assert tab.run(GROUND) == "rgb(255, 255, 255)"
        assert tab.run("getComputedStyle(document.body).color") == "rgb(23, 32, 43)"
        assert tab.run("getComputedStyle(document.querySelector('nav')).display") == "none"
        assert tab.pdf().startswith(b"%PDF")
