"""Reading rig files: TOML or YAML, all mistakes at once, each with its place and line."""

import re
import stat
import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from exumi_data.errors import ExumiError, MetadataError, UsageError
from exumi_data.model.base import STREAM_NAME
from exumi_data.model.description import Embodiment
from exumi_recorders.contract import DriverType
from exumi_recorders.drivers.registry import find_driver
from exumi_recorders.journal.header import RESERVED
from exumi_recorders.rig.model import FORMAT, VERSION, About, Controls, Device, Hooks, Limits, Rig
from exumi_recorders.rig.yaml_file import read_yaml

__all__ = ["load_rig", "parse_rig"]

_MOST_BYTES = 1 << 20
_SECTIONS: dict[str, type[BaseModel]] = {
    "rig": About,
    "embodiment": Embodiment,
    "controls": Controls,
    "limits": Limits,
    "hooks": Hooks,
}
_KNOWN = ("format", "version", *_SECTIONS, "devices")

M = TypeVar("M")
Place = tuple[str | int, ...]
LineOf = Callable[[Place], int | None]


def load_rig(path: Path) -> Rig:
    """Read a rig file.

    Parameters
    ----------
    path : pathlib.Path
        TOML, or YAML where the name ends in ``.yaml`` or ``.yml``.

    Raises
    ------
    UsageError
        There is no such file, or it is neither TOML nor YAML.
    MetadataError
        It says something wrong; `problems` lists everything that is, with lines.
    MissingExtraError
        YAML cannot be read without the extra ``record``.
    """
    raw = _read(path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"the rig file is not UTF-8 ({error.reason})", where=path) from None
    if path.suffix not in {".yaml", ".yml"}:
        return parse_rig(_toml(text, path), path=path, line_of=partial(_line_of, text))
    found = read_yaml(text, path)
    return parse_rig(
        found.document,
        path=path,
        line_of=partial(_line_in, found.lines),
        mistakes=[(place, "stands there twice") for place in found.twice],
    )


def _read(path: Path) -> bytes:
    fix = f"Make one with: exumi rig init {path}"
    try:
        found = path.stat()
        # Reading a device or a pipe could wait for ever, or never end.
        if not stat.S_ISREG(found.st_mode):
            raise UsageError("is no file", where=path, fix="Name a rig file, or say: simulated.")
        if found.st_size > _MOST_BYTES:
            raise UsageError(f"{found.st_size:,} bytes are too many for a rig file", where=path)
        return path.read_bytes()
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        missing = isinstance(error, FileNotFoundError)
        raise UsageError(
            f"the rig file cannot be read ({why})", where=path, fix=fix if missing else None
        ) from None


def _toml(text: str, path: Path) -> Any:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"not TOML: {error}", where=path) from None


def parse_rig(
    document: Any,
    *,
    path: Path | None = None,
    line_of: LineOf = lambda _: None,
    mistakes: Sequence[tuple[Place, str]] = (),
) -> Rig:
    """Check what a rig file says.

    Parameters
    ----------
    document : object
        As TOML or YAML gives it.
    path : pathlib.Path, optional
        The file: for messages, and for the paths in it.
    line_of : callable, optional
        The line of a place in the file, where it is known.
    mistakes : sequence of (tuple, str), optional
        Found before: places, and what is wrong with them.

    Raises
    ------
    MetadataError
        Something is wrong; `problems` lists everything that is.
    """
    mistakes = list(mistakes)
    if not isinstance(document, dict):
        raise UsageError("the rig file holds no tables", where=path)
    if document.get("format") != FORMAT:
        mistakes.append((("format",), f'must be "{FORMAT}"'))
    version = document.get("version")
    if not isinstance(version, str) or version.split(".")[0] != VERSION.split(".", maxsplit=1)[0]:
        mistakes.append((("version",), f'must be a version that this library knows: "{VERSION}"'))
    mistakes += [
        ((key,), f"no such section; there are {', '.join(_KNOWN[2:])}")
        for key in document
        if key not in _KNOWN
    ]
    if "rig" not in document:
        mistakes.append((("rig",), "this section is missing"))
    sections = {
        name: _section(document[name], model, (name,), mistakes)
        for name, model in _SECTIONS.items()
        if name in document
    }
    tables = document.get("devices")
    devices = _devices(tables, mistakes)
    names = list(map(str, tables)) if isinstance(tables, dict) else []
    _check_names(tables, mistakes)
    _check_controls(sections.get("controls"), names, mistakes)
    if mistakes:
        raise _report(mistakes, path, line_of)
    return Rig(
        path=path,
        about=sections["rig"],
        embodiment=sections.get("embodiment"),
        controls=sections.get("controls") or Controls(),
        limits=sections.get("limits") or Limits(),
        hooks=sections.get("hooks") or Hooks(),
        devices=tuple(devices),
    )


def _section(value: Any, model: type[M], place: Place, mistakes: list[tuple[Place, str]]) -> Any:
    try:
        return TypeAdapter(model).validate_python(value)
    except ValidationError as error:
        mistakes += [((*place, *item["loc"]), _said(item)) for item in error.errors()]
        return None


def _said(item: Mapping[str, Any]) -> str:
    kind = item["type"]
    if kind == "missing":
        return "is missing"
    if kind == "extra_forbidden":
        return "there is no such setting"
    message = str(item["msg"]).removeprefix("Value error, ").removeprefix("Input ")
    message = message[:1].lower() + message[1:]
    found = item.get("input")
    return f"{message}, not {found!r}" if isinstance(found, str | int | float) else message


def _devices(value: Any, mistakes: list[tuple[Place, str]]) -> list[Device]:
    if not isinstance(value, dict) or not value:
        mistakes.append((("devices",), "at least one device is needed, as [devices.NAME]"))
        return []
    made = [_device(name, table, mistakes) for name, table in value.items()]
    return [device for device in made if device is not None]


def _device(name: str, table: Any, mistakes: list[tuple[Place, str]]) -> Device | None:
    place: Place = ("devices", name)
    if not re.fullmatch(STREAM_NAME, str(name)):
        mistakes.append((place, "a device's name is lower-case letters, digits and _"))
        return None
    if not isinstance(table, dict):
        mistakes.append((place, "must be a table"))
        return None
    rest = dict(table)
    streams = _streams(rest.pop("streams", None), (*place, "streams"), mistakes)
    driver = _driver(rest.pop("driver", None), (*place, "driver"), mistakes)
    if driver is None:
        return None
    options = _section(rest, driver.options, place, mistakes)
    if options is None or streams is None:
        return None
    return Device(name, driver, options, MappingProxyType(streams))


def _driver(value: Any, place: Place, mistakes: list[tuple[Place, str]]) -> DriverType | None:
    if not isinstance(value, str):
        mistakes.append((place, "is missing: the name of a driver"))
        return None
    try:
        return find_driver(value)
    except ExumiError as error:
        mistakes.append((place, str(error)))
        return None


def _streams(value: Any, place: Place, mistakes: list[tuple[Place, str]]) -> dict[str, str] | None:
    if not isinstance(value, dict) or not value:
        mistakes.append(
            (
                place,
                "is missing: the driver's ports and the streams' names, such as "
                '{ frames = "tactile_left" }',
            )
        )
        return None
    wrong = {port: why for port, name in value.items() if (why := _wrong_name(name))}
    mistakes += [((*place, port), why) for port, why in wrong.items()]
    return None if wrong else dict(value)


def _wrong_name(name: object) -> str | None:
    if not isinstance(name, str) or not re.fullmatch(STREAM_NAME, name):
        return "a stream's name is lower-case letters, digits and _, and begins with a letter"
    if name in RESERVED:
        return f"no stream can be called {name!r}: a journal keeps something else by that name"
    return None


def _check_names(tables: Any, mistakes: list[tuple[Place, str]]) -> None:
    """Find streams that two devices have, also where something else is wrong with a device."""
    taken: dict[str, str] = {}
    for device, table in tables.items() if isinstance(tables, dict) else ():
        streams = table.get("streams") if isinstance(table, dict) else None
        for port, name in streams.items() if isinstance(streams, dict) else ():
            if not isinstance(name, str):
                continue
            if name in taken:
                mistakes.append(
                    (
                        ("devices", device, "streams", port),
                        f"the stream {name!r} is that of device {taken[name]!r} already",
                    )
                )
            taken.setdefault(name, device)


def _check_controls(
    controls: Controls | None, names: Sequence[str], mistakes: list[tuple[Place, str]]
) -> None:
    for key in ("flag", "world_frame"):
        value = getattr(controls, key, None)
        if value is not None and value not in names:
            mistakes.append(
                (
                    ("controls", key),
                    f"there is no device {value!r}; there are {', '.join(names)}",
                )
            )


def _report(
    mistakes: Sequence[tuple[Place, str]], path: Path | None, line_of: LineOf
) -> MetadataError:
    problems = []
    for place, message in mistakes:
        line = line_of(place)
        where = f"line {line}, " if line else ""
        problems.append(f"{where}{'.'.join(map(str, place))}: {message}")
    what = problems[0] if len(problems) == 1 else f"{len(problems)} mistakes"
    if len(problems) > 1:
        what += "".join(f"\n  {problem}" for problem in problems)
    return MetadataError(what, where=path or "the rig", problems=tuple(problems))


def _line_in(lines: Mapping[tuple[str, ...], int], place: Place) -> int | None:
    """Return the line of a YAML file that a place is on, or of the nearest mapping around it."""
    words = tuple(map(str, place))
    return next((lines[words[:n]] for n in range(len(words), 0, -1) if words[:n] in lines), None)


def _line_of(text: str, place: Place) -> int | None:
    """Return the line of a TOML file that a place is on, or of the nearest table around it."""
    best: tuple[int, int] | None = None
    table: Place = ()
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[([^\[\]]+)\]", line)
        key = re.match(r"\s*([A-Za-z0-9_.\-\"']+)\s*=", line)
        if header:
            table = _parts(header[1])
            found = table
        elif key:
            found = (*table, *_parts(key[1]))
        else:
            continue
        if found == place[: len(found)] and (best is None or len(found) > best[0]):
            best = (len(found), number)
    return best[1] if best else None


def _parts(dotted: str) -> Place:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))
