"""The formats that are known, ours and those of other packages."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import exumi_converters
from exumi_converters import FORMATS, converters
from exumi_converters.registry import find_converter
from exumi_data.errors import UsageError

PLUGIN = """
class Converter:
    name = "{name}"
    version = "1"
    id_version = 1
    describes = "nothing"
    keeps = ()
    loses = ()

    def discover(self, source, options):
        raise AssertionError("nothing is converted here")

    def convert(self, item, writer):
        raise AssertionError("nothing is converted here")

converter = Converter()
"""


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where another package can be installed."""
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("their_format", None)


def install(folder: Path, registered: str, named: str) -> None:
    (folder / "their_format.py").write_text(PLUGIN.format(name=named))
    info = folder / "their_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
    text = f"[exumi.converters]\n{registered} = their_format:converter\n"
    (info / "entry_points.txt").write_text(text)


def test_our_formats_say_what_they_keep_and_lose() -> None:
    assert {"clips", "octopi"} <= set(FORMATS)
    known = converters()
    for name in FORMATS:
        converter = known[name]
        assert converter.name == name
        assert converter.describes
        assert converter.keeps
        assert find_converter(name) is converter


def test_another_package_adds_a_format(plugin: Path) -> None:
    install(plugin, "theirs", "theirs")
    assert list(converters()) == [*FORMATS, "theirs"]
    assert find_converter("theirs").describes == "nothing"


def test_two_of_one_name_are_refused_and_both_are_named(plugin: Path) -> None:
    install(plugin, "octopi", "octopi")
    with pytest.raises(UsageError, match="'octopi' is registered twice: by exumi-data and by"):
        converters()
    with pytest.raises(UsageError, match="their-package"):
        converters()


def test_a_converter_under_a_false_name_is_refused(plugin: Path) -> None:
    install(plugin, "theirs", "ours")
    with pytest.raises(UsageError, match="their-package registers as 'theirs' does not bear"):
        converters()


def test_an_unknown_format_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(UsageError, match=r"Invalid format \(bag\). Supported values are clips, "):
        find_converter("bag")


def test_the_public_names_are_there() -> None:
    for name in exumi_converters.__all__:
        assert getattr(exumi_converters, name) is not None
