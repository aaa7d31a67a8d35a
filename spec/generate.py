#!/usr/bin/env python3
"""Render what is rendered in ``spec``: tables, schemas, the conformance corpus.

Without ``--check`` it writes; with it, it compares, and returns 1 if anything differs.
"""

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from exumi_data import standard
from exumi_data.model.calibration import Intrinsics, Rectification
from exumi_data.model.episode import FORMAT_VERSION
from exumi_data.model.schema import DOCUMENTS, json_schema

HERE = Path(__file__).resolve().parent
TEXT = HERE / FORMAT_VERSION
SCHEMAS = HERE / "schema" / FORMAT_VERSION
_BLOCK = re.compile(r"<!-- begin (fields|table): (\w+) -->\n.*?<!-- end \1 -->", re.DOTALL)

Row = Iterable[object]


def table(head: Row, rows: Iterable[Row]) -> str:
    """Return a table in Markdown."""
    lines = ["| " + " | ".join(str(cell) for cell in head) + " |"]
    lines.append("|" + "---|" * len(lines[0].split(" | ")))
    lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cell(cell: object) -> str:
    return "" if cell is None else str(cell).replace("|", "\\|").replace("\n", " ")


# ------------------------------------------------------------------------------------------ fields


def _definitions() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, model in DOCUMENTS.items():
        schema = json_schema(name)
        found |= schema.get("$defs", {})
        found[model.__name__] = schema
    for value in (Intrinsics, Rectification):  # of calibration items, whose values may be anything
        found[value.__name__] = value.model_json_schema()
    return found


def _common_fields(definitions: dict[str, Any]) -> dict[str, Any]:
    """Return what streams of all kinds have: a model that the schema itself has no name for."""
    pose, width = definitions["PoseStream"], definitions["WidthStream"]
    names = [n for n in width["properties"] if n in pose["properties"] and n not in ("kind", "raw")]
    return {
        "properties": {name: width["properties"][name] for name in names},
        "required": [name for name in names if name in width["required"]],
    }


def type_of(schema: dict[str, Any]) -> str:
    """Write the type of a field in a few words."""
    if "$ref" in schema:
        return str(schema["$ref"].rpartition("/")[2])
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    branches = schema.get("anyOf") or schema.get("oneOf")
    if branches:
        return " or ".join(dict.fromkeys(type_of(branch) for branch in branches))
    return _container_type(schema)


def _container_type(schema: dict[str, Any]) -> str:
    kind = schema.get("type")
    if kind == "array":
        return f"list of {type_of(schema.get('items', {}))}"
    values = next(iter(schema.get("patternProperties", {}).values()), None)
    if kind == "object" and isinstance(values, dict):
        return f"map of {type_of(values)}"
    return str(kind) if kind else "anything"


def _default(field: dict[str, Any]) -> str:
    """Write what an absent field means, where that is neither null nor empty."""
    value = field.get("default")
    if value is None or value in ([], {}):
        return ""
    return f", default `{json.dumps(value, ensure_ascii=False)}`"


def fields(name: str) -> str:
    """Return the table of a model's fields."""
    definitions = _definitions()
    common = _common_fields(definitions)
    schema = common if name == "StreamModel" else definitions[name]
    required = schema.get("required", [])
    # What a kind has besides: the common fields have a table of their own.
    known = common["properties"] if name.endswith("Stream") else {}
    rows = []
    for key, field in schema["properties"].items():
        if key in known:
            continue
        need = "REQUIRED" if key in required else f"OPTIONAL{_default(field)}"
        text = " ".join(str(field.get("description", "")).replace("``", "`").split())
        rows.append((f"`{key}`", type_of(field), need, text))
    return table(("field", "type", "", "meaning"), rows)


# ------------------------------------------------------------------------------------------ tables


def _array_row(owner: str, spec: standard.ArraySpec) -> Row:
    name = f"**`{spec.name}`**" if spec.required else f"`{spec.name}`"
    dtype = ", ".join(spec.dtype) if len(spec.dtype) < 4 else "any number"
    shape = f"({', '.join(str(size) for size in spec.shape)})"
    return owner, name, dtype, shape, ", ".join(spec.dimensions), spec.unit or "stated", spec.text


def _arrays() -> str:
    rows = [_array_row("any", spec) for spec in standard.common_arrays().values()]
    for encoding in standard.encodings().values():
        owner = f"images, `{encoding.name}`"
        rows += [_array_row(owner, spec) for spec in encoding.arrays.values()]
    for kind in standard.kinds().values():
        rows += [_array_row(kind.name, spec) for spec in kind.arrays.values()]
    return table(("of", "array", "data type", "shape", "axes", "unit", "meaning"), rows)


def _derived() -> str:
    specs = standard.derived_arrays().values()
    rows = [_array_row(", ".join(spec.kinds), spec) for spec in specs]
    return table(("of", "array", "data type", "shape", "axes", "unit", "meaning"), rows)


def _kinds() -> str:
    rows = [(f"`{kind.name}`", kind.status, kind.text) for kind in standard.kinds().values()]
    return table(("kind", "status", "meaning"), rows)


def _units() -> str:
    rows = [(f"`{u.name}`", u.quantity, u.si, u.text) for u in standard.units().values()]
    return table(("unit", "quantity", "in SI units", "meaning"), rows)


def _flags() -> str:
    rows = [(f.bit, f.mask, f"`{f.name}`", f.text) for f in standard.flags().values()]
    return table(("bit", "value", "flag", "meaning"), rows)


def _stamps() -> str:
    rows = [(f"`{point.name}`", point.text) for point in standard.stamp_points().values()]
    return table(("stamp point", "meaning"), rows)


def _sensors() -> str:
    rows = [
        (f"`{s.name}`", s.maker, s.kind, s.light or "", s.text) for s in standard.sensors().values()
    ]
    return table(("sensor", "maker", "kind", "light", "notes"), rows)


def _catalog() -> str:
    from exumi_data.catalog import catalog_schema

    columns = catalog_schema()
    rows = [(f"`{f.name}`", f.type, "" if f.nullable else "never null") for f in columns]
    return table(("column", "Arrow type", ""), rows)


def _limits() -> str:
    rows = [
        (f"[{rule.id}]({rule.anchor.removeprefix('quality.md')})", f"`{name}`", f"{value:g}")
        for rule in standard.rules().values()
        for name, value in rule.limits.items()
    ]
    return table(("rule", "limit", "value"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "arrays": _arrays,
    "catalog": _catalog,
    "derived": _derived,
    "flags": _flags,
    "kinds": _kinds,
    "limits": _limits,
    "sensors": _sensors,
    "stamps": _stamps,
    "units": _units,
}


# ------------------------------------------------------------------------------------------- files


def rendered(text: str) -> str:
    """Return a text with its tables rendered."""

    def block(match: re.Match[str]) -> str:
        what, name = match[1], match[2]
        content = fields(name) if what == "fields" else TABLES[name]()
        return f"<!-- begin {what}: {name} -->\n\n{content}\n<!-- end {what} -->"

    return _BLOCK.sub(block, text)


def rules_page() -> str:
    """Return ``rules.md``."""
    rows = [
        (
            f"[{rule.id}]({rule.anchor})",
            rule.severity,
            rule.level,
            rule.title,
            " or ".join(rule.places),
            rule.since,
        )
        for rule in standard.rules().values()
    ]
    head = (
        f"# The rules of exUMI {FORMAT_VERSION}\n\n"
        "Rendered by `spec/generate.py` from `exumi_data/standard/rules/`. A rule's title says\n"
        "what holds when it is kept; its findings have the [places](#places) that are named.\n\n"
    )
    names = ("rule", "severity", "level", "title", "place", "since")
    return head + table(names, rows) + _places()


def _places() -> str:
    """Return the section on the places of findings."""
    rows = [
        (place.name, place.path, "yes" if place.pointer else "", place.index, place.text)
        for place in standard.places().values()
    ]
    head = (
        "\n## Places\n\n"
        "Paths are relative to the episode, in a dataset's own files to the dataset. A pointer is\n"
        "a JSON pointer (RFC 6901) into the document at the path. Indices count from 0. Of\n"
        "findings with an index one may stand for all that the rule has at its place; any other\n"
        "finding stands for itself.\n\n"
    )
    return head + table(("place", "path", "pointer", "index", "what is there"), rows)


def rules_table() -> str:
    """Return ``rules.json``: the rule table for programs of others."""
    rows = {
        rule.id: {
            "severity": rule.severity,
            "level": rule.level,
            "title": rule.title,
            "text": rule.anchor,
            "since": rule.since,
            "places": list(rule.places),
            "limits": dict(rule.limits),
        }
        for rule in standard.rules().values()
    }
    where = {
        place.name: {
            "path": place.path,
            "pointer": place.pointer,
            "index": place.index,
            "text": place.text,
        }
        for place in standard.places().values()
    }
    document = {"format_version": FORMAT_VERSION, "rules": rows, "places": where}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def outputs() -> dict[Path, str]:
    """Return every rendered file but the corpus."""
    found = {
        path: rendered(path.read_text("utf-8"))
        for path in sorted(TEXT.glob("*.md"))
        if path.name != "rules.md"
    }
    found[TEXT / "rules.md"] = rules_page()
    found[TEXT / "rules.json"] = rules_table()
    for name in DOCUMENTS:
        text = json.dumps(json_schema(name), indent=1, ensure_ascii=False) + "\n"
        found[SCHEMAS / f"{name}.schema.json"] = text
    return found


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    check = parser.parse_args().check
    wrong = []
    for path, text in outputs().items():
        if check:
            if not path.is_file() or path.read_text("utf-8") != text:
                wrong.append(path)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    for path in wrong:
        sys.stderr.write(f"differs: {path.relative_to(HERE)}\n")
    codes = [_run(name, check=check) for name in ("generate.py", "make_dumps.py")]
    return 1 if wrong or any(codes) else 0


def _run(name: str, *, check: bool) -> int:
    """Run a program of the conformance corpus."""
    command = [sys.executable, str(HERE / "conformance" / name), *(["--check"] if check else [])]
    return subprocess.run(command, check=False).returncode  # noqa: S603  # our own program


if __name__ == "__main__":
    sys.exit(main())
