"""Rig files in YAML: what they say, on which lines, and what they say twice."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exumi_data.errors import MissingExtraError, UsageError

__all__ = ["YamlFile", "read_yaml"]

Place = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class YamlFile:
    """What a YAML file holds.

    Attributes
    ----------
    document : object
    lines : mapping of tuple of str to int
        Where each key and each element stands.
    twice : tuple of tuple of str
        Keys that stand there a second time: YAML would take the last one without a word.
    """

    document: Any
    lines: Mapping[Place, int]
    twice: tuple[Place, ...]


def read_yaml(text: str, path: Path) -> YamlFile:
    """Read a file's text.

    Parameters
    ----------
    text : str
    path : pathlib.Path
        Named in errors.

    Raises
    ------
    UsageError
        It is no YAML.
    MissingExtraError
        YAML cannot be read without the extra ``record``.
    """
    try:
        import yaml
    except ImportError:
        raise MissingExtraError(
            "YAML cannot be read",
            where=path,
            fix='Install it with: pip install "exumi-data[record]", or write TOML.',
        ) from None
    lines: dict[Place, int] = {}
    twice: list[Place] = []
    seen: set[int] = set()

    def walk(node: Any, place: Place) -> None:
        if id(node) in seen:
            return  # an alias: what it stands for was looked at
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            here: set[Place] = set()
            for key, value in node.value:
                inner = (*place, str(key.value))
                if inner in here:
                    twice.append(inner)
                here.add(inner)
                lines[inner] = key.start_mark.line + 1
                walk(value, inner)
        elif isinstance(node, yaml.SequenceNode):
            for number, value in enumerate(node.value):
                lines[*place, str(number)] = value.start_mark.line + 1
                walk(value, (*place, str(number)))

    loader = yaml.SafeLoader(text)
    try:
        root = loader.get_single_node()
        if root is None:
            return YamlFile(None, {}, ())
        walk(root, ())  # before anything is made of it: that changes the nodes
        return YamlFile(loader.construct_document(root), lines, tuple(twice))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise UsageError(f"not YAML: {' '.join(str(error).split())}", where=path) from None
    finally:
        loader.dispose()
