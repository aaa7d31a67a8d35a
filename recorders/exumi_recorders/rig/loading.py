"""Reading rig files: TOML or YAML, all mistakes at once, each with its place and line."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from exumi_data.errors import ExumiError, MetadataError, MissingExtraError, UsageError
from exumi_data.model.base import STREAM_NAME
from exumi_data.model.description import Embodiment
from exumi_recorders.contract import DriverType
from exumi_recorders.drivers.registry import find_driver
from exumi_recorders.journal.header import RESERVED
from exumi_recorders.rig.model import FORMAT, VERSION, About, Controls, Device, Hooks, Limits, Rig

__all__ = ["load_rig", "parse_rig"]

_MOST_BYTES = 1 << 20
_YAML = (".yaml", ".yml")
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
    try:
        size = path.stat().st_size
        raw = path.read_bytes() if size <= _MOST_BYTES else b""
    except OSError as error:
        raise UsageError(
            f"the rig file cannot be read ({error.strerror})",
            where=path,
            fix=f"Make one with: exumi rig init {path}",
        ) from None
    if size > _MOST_BYTES:
        raise UsageError(f"{size:,} bytes are too many for a rig file", where=path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"the rig file is not UTF-8 ({error.reason})", where=path) from None
    document = _from_yaml(text, path) if path.suffix in _YAML else _toml(text, path)
    return parse_rig(document, path=path, text=text)


def _toml(text: str, path: Path) -> Any:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"not TOML: {error}", where=path) from None


def _from_yaml(text: str, path: Path) -> Any:
    try:
        import yaml
    except ImportError:
        raise MissingExtraError(
            "YAML cannot be read",
            where=path,
            fix='Install it with: pip install "exumi-data[record]", or write TOML.',
        ) from None
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise UsageError(f"not YAML: {' '.join(str(error).split())}", where=path) from None


def parse_rig(document: Any, *, path: Path | None = None, text: str = "") -> Rig:
    """Check what a rig file says.

    Parameters
    ----------
    document : object
        As TOML or YAML gives it.
    path : pathlib.Path, optional
        The file: for messages, and for the paths in it.
    text : str, optional
        The file's text, to name lines.

    Raises
    ------
    MetadataError
        Something is wrong; `problems` lists everything that is.
    """
    mistakes: list[tuple[Place, str]] = []
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
    devices = _devices(document.get("devices"), mistakes)
    _check_names(devices, mistakes)
    _check_controls(sections.get("controls"), devices, mistakes)
    if mistakes:
        raise _report(mistakes, path, text)
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
    wrong = [
        port
        for port, name in value.items()
        if not isinstance(name, str) or not re.fullmatch(STREAM_NAME, name)
    ]
    mistakes += [
        (
            (*place, port),
            "a stream's name is lower-case letters, digits and _, and begins with a letter",
        )
        for port in wrong
    ]
    return None if wrong else dict(value)


def _check_names(devices: Sequence[Device], mistakes: list[tuple[Place, str]]) -> None:
    taken: dict[str, str] = {}
    for device in devices:
        for port, name in device.streams.items():
            if name in taken:
                mistakes.append(
                    (
                        ("devices", device.name, "streams", port),
                        f"the stream {name!r} is that of device {taken[name]!r} already",
                    )
                )
            if name in RESERVED:
                place = ("devices", device.name, "streams", port)
                mistakes.append((place, f"no stream can be called {name!r}: choose another name"))
            taken.setdefault(name, device.name)


def _check_controls(
    controls: Controls | None, devices: Sequence[Device], mistakes: list[tuple[Place, str]]
) -> None:
    names = [device.name for device in devices]
    for key in ("flag", "world_frame"):
        value = getattr(controls, key, None)
        if value is not None and value not in names:
            mistakes.append(
                (
                    ("controls", key),
                    f"there is no device {value!r}; there are {', '.join(names)}",
                )
            )


def _report(mistakes: Sequence[tuple[Place, str]], path: Path | None, text: str) -> MetadataError:
    problems = []
    line_of = _yaml_line_of if path is not None and path.suffix in _YAML else _line_of
    for place, message in mistakes:
        line = line_of(text, place)
        where = f"line {line}, " if line else ""
        problems.append(f"{where}{'.'.join(map(str, place))}: {message}")
    what = problems[0] if len(problems) == 1 else f"{len(problems)} mistakes"
    if len(problems) > 1:
        what += "".join(f"\n  {problem}" for problem in problems)
    return MetadataError(what, where=path or "the rig", problems=tuple(problems))


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


def _yaml_line_of(text: str, place: Place) -> int | None:
    """Return the line of a YAML file that a place is on, or of the nearest one around it."""
    import yaml

    node = yaml.compose(text, Loader=yaml.SafeLoader)
    line: int | None = None
    for part in place:
        if isinstance(node, yaml.MappingNode):
            found = next((pair for pair in node.value if pair[0].value == str(part)), None)
            if found is None:
                return line
            line, node = found[0].start_mark.line + 1, found[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line + 1
    return line


def _parts(dotted: str) -> Place:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))
