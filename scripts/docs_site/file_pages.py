"""Pages that show files of the repository to which other pages link."""

import posixpath
from pathlib import Path

from links import ROOT, page_of, relative, rewritten, targets

__all__ = ["file_pages"]

_LANGUAGES = {".py": "python", ".json": "json", ".toml": "toml", ".md": "markdown", ".csv": "text"}
# Nobody reads more, and a page of it is slow.
_LARGEST = 200_000
_HIDDEN = "---\nsearch:\n  exclude: true\n---\n\n"


def file_pages(sources: dict[str, str]) -> dict[str, str]:
    """Return a page for all that is linked to and is no page yet.

    Parameters
    ----------
    sources : dict of str to str
        Markdown of the pages by their path in the repository.

    Returns
    -------
    dict of str to str
        Markdown by the page's place on the site.

    Raises
    ------
    FileNotFoundError
        If a link leads nowhere.
    """
    found: dict[str, str] = {}
    waiting = [target for path, text in sources.items() for target in targets(text, path)]
    while waiting:
        path = waiting.pop()
        page = page_of(path)
        if not page.startswith("files/") or page in found:
            continue
        if path.startswith("..") or not (ROOT / path).exists():
            msg = f"a page links to {path}, which is not there"
            raise FileNotFoundError(msg)
        body, linked = _body(path, page)
        found[page] = f"{_HIDDEN}{body}"
        waiting += linked
    return found


def _body(path: str, page: str) -> tuple[str, list[str]]:
    """Return what a page shows, and what it links to."""
    here = ROOT / path
    if here.is_dir():
        inside = sorted(child for child in here.iterdir() if _is_shown(child))
        paths = [posixpath.join(path, child.name) for child in inside]
        lines = [f"- [`{posixpath.basename(p)}`]({relative(page, page_of(p))})" for p in paths]
        return f"# `{path}/`\n\n" + "\n".join(lines) + "\n", paths
    text = here.read_text("utf-8")
    if here.suffix == ".md":
        return rewritten(text, path, page), list(targets(text, path))
    cut = "" if len(text) <= _LARGEST else "\n\nThe file is longer than what is shown.\n"
    language = _LANGUAGES.get(here.suffix, "text")
    return f"# `{path}`\n\n`````{language}\n{text[:_LARGEST]}\n`````{cut}\n", []


def _is_shown(path: Path) -> bool:
    """Whether a folder's page lists it: text, and no leavings of programs."""
    if path.name.startswith((".", "__pycache__")) or path.name.endswith(".egg-info"):
        return False
    return path.is_dir() or path.suffix in _LANGUAGES
