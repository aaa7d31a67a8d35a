"""The contract of stream kinds finds what is wrong with one."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pytest
from pydantic import Field

from exumi_data import extensions
from exumi_data.extensions import StreamKind, mistakes_of_kind
from exumi_data.model.streams import ExtensionStream
from exumi_data.plugins import Plugin
from exumi_data.standard import ArraySpec
from exumi_data.testing import check_stream_kind
from tests.exumi_data.builders import write_episode

DATA = ArraySpec(
    name="data", dtype=("float64",), shape=("N",), dimensions=("time",), required=True, text="x"
)
SMELL = StreamKind(
    name="acme:smell",
    version="1",
    schema_url="https://acme.example/smell.json",
    text="What a nose says.",
    arrays=(DATA,),
)


class Named(ExtensionStream):
    nose: Annotated[str, Field(alias="acme:nose")]


class Stray(ExtensionStream):
    nose: str = ""


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_episode(tmp_path_factory.mktemp("smell") / "episode.zarr")


def registered(monkeypatch: pytest.MonkeyPatch, kind: StreamKind) -> StreamKind:
    plugin = Plugin(extensions.STREAM_KINDS, kind.name, "acme", "1", kind)
    monkeypatch.setattr(extensions, "stream_kind_plugins", lambda: {kind.name: plugin})
    return kind


def test_a_right_description(episode: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_stream_kind(registered(monkeypatch, SMELL), episode)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "acme:scent"}, "no stream of the kind acme:scent"),
        ({"version": "2"}, "it is of version 1, not 2"),
        ({"schema_url": "https://acme.example/x"}, "its schema_url is"),
        ({"schema_url": "smell.json"}, "is no address"),
        ({"arrays": (DATA, replace(DATA, name="gas"))}, "it lacks the array gas"),
        ({"arrays": (replace(DATA, dtype=("int16",)),)}, "data is float64, not int16"),
        ({"arrays": (replace(DATA, name="time"),)}, "time is one that every stream may have"),
        ({"metadata": Named}, "its metadata is not as described"),
        ({"metadata": Stray}, "the key nose does not begin with acme:"),
    ],
)
def test_what_is_wrong_is_named(
    change: dict[str, object], message: str, episode: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = registered(monkeypatch, replace(SMELL, **change))  # type: ignore[arg-type]  # its own fields
    with pytest.raises(AssertionError, match=message):
        check_stream_kind(kind, episode)


def test_a_kind_that_is_not_installed(episode: Path) -> None:
    with pytest.raises(AssertionError, match="no installed package registers acme:smell 1"):
        check_stream_kind(SMELL, episode)


def test_names() -> None:
    assert mistakes_of_kind(SMELL) == []
    assert mistakes_of_kind(replace(SMELL, name="smell"))
    assert mistakes_of_kind(replace(SMELL, metadata=Named)) == []
    assert replace(SMELL, metadata=Named).keys == {"acme:nose"}
