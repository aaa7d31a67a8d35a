"""Links of pages that lie in the repository, as links of the site.

Pages link to what lies beside them in the repository, so that they can be read there too. On the
site the pages below ``docs/`` and ``spec/`` are pages; of every other file or folder that is linked
to, a page is made that shows it.
"""

import posixpath
import re
from collections.abc import Callable
from pathlib import Path

__all__ = ["ROOT", "SPEC_PAGES", "page_of", "relative", "rewritten", "targets"]

ROOT = Path(__file__).resolve().parents[2]

SPEC_PAGES = {
    "spec/README.md": "spec/index.md",
    "spec/1.0/episode.md": "spec/episode.md",
    "spec/1.0/dataset.md": "spec/dataset.md",
    "spec/1.0/quality.md": "spec/quality.md",
    "spec/1.0/registry.md": "spec/registry.md",
    "spec/1.0/notes.md": "spec/notes.md",
    "spec/1.0/rules.md": "rules/index.md",
    "spec/conformance/README.md": "spec/conformance.md",
    "spec/readers/README.md": "spec/readers.md",
    "examples/README.md": "examples.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "benchmarks/README.md": "benchmarks.md",
}
"""What is a page of the site as it stands, and where."""

_LINK = re.compile(r"(?P<head>\]\()(?P<path>[^)\s#]+)(?P<anchor>#[^)\s]*)?\)")
_CODE = re.compile(r"^(`{3,}).*?^\1`*$|(?<!`)(`+)(?!`).+?(?<!`)\2(?!`)", re.DOTALL | re.MULTILINE)


def page_of(path: str) -> str:
    """Return where on the site something of the repository is.

    Parameters
    ----------
    path : str
        A file or folder, relative to the repository, with ``/``.
    """
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path in SPEC_PAGES:
        return SPEC_PAGES[path]
    return f"files/{path}/index.md" if (ROOT / path).is_dir() else f"files/{path}.md"


def relative(page: str, other: str) -> str:
    """Return the link from one page of the site to another."""
    return posixpath.relpath(other, posixpath.dirname(page) or ".")


def targets(text: str, path: str) -> set[str]:
    """Return what a text links to, relative to the repository.

    Parameters
    ----------
    text : str
        Markdown.
    path : str
        Where the text is, relative to the repository.
    """
    found: set[str] = set()

    def note(target: str) -> str:
        found.add(target)
        return page_of(target)

    _with_links(text, path, note)
    return found


def rewritten(text: str, path: str, page: str) -> str:
    """Return a text with its links as links of the site.

    Parameters
    ----------
    text : str
        Markdown.
    path : str
        Where the text is, relative to the repository: its links start there.
    page : str
        Where on the site it is to stand.
    """
    return _with_links(text, path, lambda target: relative(page, page_of(target)))


def _with_links(text: str, path: str, link: Callable[[str], str]) -> str:
    """Return a text with its relative links exchanged; what is code stays as it is."""
    folder = posixpath.dirname(path)

    def one(match: re.Match[str]) -> str:
        if "://" in match["path"] or match["path"].startswith("mailto:"):
            return match[0]
        target = posixpath.normpath(posixpath.join(folder, match["path"]))
        return f"{match['head']}{link(target)}{match['anchor'] or ''})"

    parts, at = [], 0
    for code in _CODE.finditer(text):
        parts += [_LINK.sub(one, text[at : code.start()]), code[0]]
        at = code.end()
    return "".join([*parts, _LINK.sub(one, text[at:])])
