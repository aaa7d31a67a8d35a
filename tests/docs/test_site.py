"""The documentation as a site: built as ``make docs`` does, whole, and without the network.

EXUMI_SITE names the site where ``make docs`` has built it; otherwise it is built here.
"""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from exumi_data.standard import rules
from tests.browser import open_browser

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "mkdocs.yml"
TIMEOUT_S = 300
# What a browser fetches when it opens a page: links that are clicked are no such thing.
FETCHED = re.compile(
    r"<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\bsrc=[\"']?([^\"' >]+)"
    r"|<link\b[^>]*?\bhref=[\"']?([^\"' >]+)"
    r"|@import\s+[\"']([^\"']+)|url\([\"']?([^\"')]+)"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, which is built if it is not there yet."""
    made = os.environ.get("EXUMI_SITE")
    if made:
        return Path(made)
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    # Not --quiet: --strict then sees no warnings either.
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    done = subprocess.run(
        [*command, "--config-file", str(CONFIG), "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONWARNINGS": "default"},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def in_nav(entries: list[Any]) -> list[str]:
    """Paths of the pages that a part of the navigation names."""
    found: list[str] = []
    for entry in entries:
        value = next(iter(entry.values())) if isinstance(entry, dict) else entry
        found += in_nav(value) if isinstance(value, list) else [value]
    return found


def test_every_page_is_in_the_navigation_once() -> None:
    # The tags of mkdocs-material's own configuration are not used, so that this is plain YAML.
    named = in_nav(yaml.safe_load(CONFIG.read_text())["nav"])
    assert len(set(named)) == len(named)
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert pages - set(named) == set()


def test_every_rule_has_a_whole_page(site: Path) -> None:
    index = (site / "rules" / "index.html").read_text()
    for rule in rules().values():
        page = (site / "rules" / f"{rule.id}.html").read_text()
        for heading in ("What", "Why", "An example that breaks it", "How to mend it"):
            assert re.search(f"<h2[^>]*>{heading}<", page), f"{rule.id} lacks {heading!r}"
        assert f'href="{rule.id}.html"' in index or f"href={rule.id}.html" in index


def test_nothing_is_fetched_from_elsewhere(site: Path) -> None:
    seen = 0
    for path in [*site.rglob("*.html"), *site.rglob("*.css")]:
        for match in FETCHED.finditer(path.read_text("utf-8")):
            address = next(group for group in match.groups() if group)
            seen += 1
            assert not re.match(r"(https?:)?//", address), f"{path.relative_to(site)}: {address}"
    assert seen > len(rules())


@pytest.mark.parametrize("dark", [False, True])
def test_pages_open_from_a_disk(site: Path, dark: bool) -> None:
    pages = ("index.html", "format.html", "rules/TIME-001.html", "api/exumi_loaders.html")
    scheme = "slate" if dark else "default"
    with open_browser() as browser:
        for page in pages:
            for width in (1280, 390):
                with browser.tab(site / page, (width, 900), dark=dark) as tab:
                    assert tab.errors == []
                    assert all(url.startswith(("file:", "data:")) for url in tab.requests)
                    assert tab.run("document.body.dataset.mdColorScheme") == scheme
                    # A phone shows the page at its own width: nothing reaches out to the side.
                    assert tab.run("document.documentElement.scrollWidth <= innerWidth")


def test_search_works_without_a_server(site: Path) -> None:
    with open_browser() as browser, browser.tab(site / "index.html") as tab:
        tab.run(
            "{const box = document.querySelector('[data-md-component=search-query]');"
            "document.querySelector('[data-md-toggle=search]').click(); box.focus();"
            "box.value = 'nudged'; box.dispatchEvent(new Event('input', {bubbles: true}));"
            "box.dispatchEvent(new KeyboardEvent('keyup', {bubbles: true}))}"
        )
        links: list[str] = []
        for _ in range(50):
            browser.listen(0.2)
            links = tab.run(
                "[...document.querySelectorAll('.md-search-result a')].map(a => a.href)"
            )
            if links:
                break
        assert any("TIME-001.html" in link for link in links), links
