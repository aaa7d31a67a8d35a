"""Fill the marked places of the documentation with what the benchmarks printed.

They are the tables of ``docs/performance.md`` and that of the sweeps in ``docs/calibration.md``.
The figures come from ``benchmarks/results/*.json``, which the scripts in ``benchmarks/`` write with
``--json``. Without ``--check`` it writes the pages; with it, it compares, and returns 1 if any
differs.
"""

import argparse
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from performance_rows import TABLES, TEXTS, Results, Row

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "docs" / "performance.md", ROOT / "docs" / "calibration.md")
RESULTS = ROOT / "benchmarks" / "results"
_PLACE = re.compile(r"<!-- begin measured: (\w+) -->\n.*?<!-- end measured -->", re.DOTALL)


def table(rows: tuple[Row, ...], results: Mapping[str, Results]) -> str:
    """Return a table in Markdown.

    Parameters
    ----------
    rows : tuple of Row
    results : mapping of str to mapping
        Contents of the JSON files by name.
    """
    lines = ["| what | measured | by |", "|---|---|---|"]
    for row in rows:
        names = dict.fromkeys(results[file]["benchmark"] for file in row.files)
        figures = row.measured(*(results[file] for file in row.files))
        lines.append(f"| {row.what} | {figures} | {', '.join(f'`{n}.py`' for n in names)} |")
    return "\n".join(lines)


def filled(text: str, results: Mapping[str, Results]) -> str:
    """Return a page with its marked places filled."""

    def one(match: re.Match[str]) -> str:
        name = match[1]
        if name in TABLES:
            body = table(TABLES[name], results)
        else:
            body = TEXTS[name].written(results[TEXTS[name].file])
        return f"<!-- begin measured: {name} -->\n\n{body}\n\n<!-- end measured -->"

    return _PLACE.sub(one, text)


def read_results() -> dict[str, Results]:
    """Return the contents of all results by name."""
    return {p.stem: json.loads(p.read_text("utf-8")) for p in sorted(RESULTS.glob("*.json"))}


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    check = parser.parse_args().check
    results, wrong = read_results(), 0
    for page in PAGES:
        text = page.read_text("utf-8")
        new = filled(text, results)
        if not check:
            page.write_text(new, "utf-8")
        elif new != text:
            sys.stderr.write(f"differs: {page}; run python scripts/performance_page.py\n")
            wrong = 1
    return wrong


if __name__ == "__main__":
    sys.exit(main())
