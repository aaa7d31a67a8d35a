from pathlib import Path

import pytest

from exumi_data.errors import UsageError
from exumi_data.release.licence import canonical_licence, find_licence_text


@pytest.mark.parametrize(
    ("text", "licence"),
    [
        ("cc-by-4.0", "CC-BY-4.0"),
        ("mit or apache-2.0", "MIT OR Apache-2.0"),
        ("LicenseRef-our-lab", "LicenseRef-our-lab"),
    ],
)
def test_canonical(text: str, licence: str) -> None:
    assert canonical_licence(text) == licence


@pytest.mark.parametrize("text", ["", " ", "NOASSERTION", "none", "free", "CC-BY", "MIT AND"])
def test_no_licence(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        canonical_licence(text)
    assert "CC-BY-4.0" in str(caught.value)


def test_text_beside_the_data(tmp_path: Path) -> None:
    (tmp_path / "LICENCE.txt").write_bytes(b"Creative Commons  \r\nAttribution\n4.0 International")
    text = find_licence_text(tmp_path, None, "CC-BY-4.0")
    assert text == b"Creative Commons\nAttribution\n4.0 International\n"


def test_a_named_file_comes_first(tmp_path: Path) -> None:
    (tmp_path / "LICENSE").write_text("other")
    (tmp_path / "mine").write_text("mine")
    assert find_licence_text(tmp_path, tmp_path / "mine", "LicenseRef-x") == b"mine\n"


def test_missing_text_says_where_it_is(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"--licence-file.*https://spdx.org/licenses/CC0-1.0.html"):
        find_licence_text(tmp_path, None, "CC0-1.0")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"Apache License, Version 2.0", "not the text of CC-BY-4.0"),
        (b"Attribution-NonCommercial 4.0 International", "not the text of CC-BY-4.0"),
        (b" \n", "empty"),
        (b"\xff\xfe", "UTF-8"),
    ],
)
def test_wrong_text(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "LICENSE").write_bytes(content)
    with pytest.raises(UsageError, match=said):
        find_licence_text(tmp_path, None, "CC-BY-4.0")


def test_every_part_of_an_expression_has_its_text(tmp_path: Path) -> None:
    (tmp_path / "LICENSE").write_text("Apache License")
    with pytest.raises(UsageError, match="MIT"):
        find_licence_text(tmp_path, None, "Apache-2.0 AND MIT")
