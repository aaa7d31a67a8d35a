"""Fill the tables of ``docs/performance.md`` with what the benchmarks printed.

The figures come from ``benchmarks/results/*.json``, which the scripts in ``benchmarks/`` write with
``--json``. Without ``--check`` it writes the page; with it, it compares, and returns 1 if the two
differ.
"""

import argparse
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from performance_rows import TABLES, Results, Row

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "performance.md"
RESULTS = ROOT / "benchmarks" / "results"
_TABLE = re.compile(r"<!-- begin measured: (\w+) -->\n.*?<!-- end measured -->", re.DOTALL)


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
    """Return the page with its tables filled."""

    def one(match: re.Match[str]) -> str:
        name = match[1]
        body = table(TABLES[name], results)
        return f"<!-- begin measured: {name} -->\n\n{body}\n\n<!-- end measured -->"

    return _TABLE.sub(one, text)


def read_results() -> dict[str, Results]:
    """Return the contents of all results by name."""
    return {p.stem: json.loads(p.read_text("utf-8")) for p in sorted(RESULTS.glob("*.json"))}


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    check = parser.parse_args().check
    text = PAGE.read_text("utf-8")
    new = filled(text, read_results())
    if not check:
        PAGE.write_text(new, "utf-8")
    elif new != text:
        sys.stderr.write(f"differs: {PAGE}; run python scripts/performance_page.py\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
