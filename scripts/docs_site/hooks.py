"""What MkDocs calls while it builds the site: pages that are made, and links.

See ``hooks`` in ``mkdocs.yml``.
"""

from pathlib import Path
from typing import Any

from api_pages import API_MODULES, api_pages
from file_pages import file_pages
from links import ROOT, SPEC_PAGES, rewritten
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from rule_pages import SECTIONS, by_section, rule_pages

__all__ = ["on_config", "on_files", "on_page_markdown"]

_IN_REPOSITORY = {page: path for path, page in SPEC_PAGES.items() if not page.startswith("rules/")}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages that are made into the navigation, where it names their folders."""
    if config.nav is not None:
        config.nav = [_expanded(entry) for entry in config.nav]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made."""
    sources = {
        f"docs/{file.src_uri}": Path(str(file.abs_src_path)).read_text("utf-8")
        for file in files.documentation_pages()
    }
    texts = {path: (ROOT / path).read_text("utf-8") for path in SPEC_PAGES}
    made = {page: texts[path] for path, page in SPEC_PAGES.items()}
    # The catalogue stands in the place of the rule table.
    made |= rule_pages() | api_pages() | file_pages(sources | texts)
    for page, text in made.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Rewrite the links of a page that lies in the repository."""
    uri = page.file.src_uri
    if page.file.generated_by is not None and uri not in _IN_REPOSITORY:
        return markdown
    return rewritten(markdown, _IN_REPOSITORY.get(uri, f"docs/{uri}"), uri)


def _expanded(entry: Any) -> Any:
    """Return an entry of the navigation, with the pages of a folder that is made."""
    if not isinstance(entry, dict):
        return entry
    [(name, value)] = entry.items()
    if isinstance(value, list):
        return {name: [_expanded(child) for child in value]}
    if value == "rules/":
        return {name: ["rules/index.md", *_rules()]}
    if value == "api/":
        return {name: ["api/index.md", *_modules()]}
    return entry


def _rules() -> list[Any]:
    return [
        {SECTIONS[name]: [{rule.id: f"rules/{rule.id}.md"} for rule in section]}
        for name, section in by_section().items()
    ]


def _modules() -> list[Any]:
    return [
        {heading: [{name: f"api/{name}.md"} for name in modules]}
        for heading, modules in API_MODULES.items()
    ]
