"""Tables of labels: what they say, and every way in which they can be wrong."""

from pathlib import Path

import pytest

from exumi_converters import ConvertOptions, convert
from exumi_converters.octopi_labels import read_labels, slug
from exumi_data.errors import UsageError


def test_slugs() -> None:
    assert slug("a TV remote") == "a_tv_remote"
    assert slug("an unpeeled, ripe avocado") == "an_unpeeled_ripe_avocado"


def test_parts_of_an_object_share_its_id(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_text(
        "part_id,object,part\nbrush_handle,a hairbrush,handle\nbrush_end,a hairbrush,ends\nx,,\n"
    )
    table, _ = read_labels(path)
    assert table["brush_handle"].object_id == table["brush_end"].object_id == "a_hairbrush"
    assert table["x"].object_id is None


def test_a_table_of_a_spreadsheet_program_is_read(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_bytes("\ufeffpart_id, hardness_0_10 \r\negg, 7.5\r\n\r\n".encode())
    table, notices = read_labels(path)
    assert [label.value for label in table["egg"].labels] == [7.5]
    assert notices == []


def test_who_rated_is_said_of_published_parts_only(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_text("part_id,hardness_0_10,split_octopi1\negg,7.5,train\nmine,3,\n")
    table, _ = read_labels(path)
    assert table["egg"].labels[0].origin == "labels.csv: mean of about three raters"
    assert table["mine"].labels[0].origin == "labels.csv"


def test_columns_that_are_not_understood_are_named(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_text("part_id,colour,hardness_0_10\negg,white,7\n")
    _, (notice,) = read_labels(path)
    assert "colour" in notice
    assert "labels.csv" in notice


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column part_id; its header has: nothing"),
        ("id,hardness_0_10\negg,7\n", "no column part_id; its header has: id, hardness_0_10"),
        ("part_id,part_id\negg,egg\n", "column 'part_id' for the second time"),
        ("part_id,hardness_0_10\negg\n", "line 2: 1 cells, the header has 2"),
        ("part_id,hardness_0_10\negg,soft\n", "line 2: hardness_0_10 is 'soft', not a number"),
        ("part_id,hardness_0_10\negg,11\n", "line 2: hardness_0_10 is '11', not a number from 0"),
        ("part_id,roughness_0_10\negg,nan\n", "roughness_0_10 is 'nan'"),
        ("part_id,object\negg,an egg\nphysiclear_egg,egg\n", "'egg' for the second time"),
        ("part_id,object\n,an egg\n", "line 2: the row has no part id"),
        ('part_id\n"egg\n', "not a CSV table"),
    ],
)
def test_a_malformed_table_is_refused_before_anything_is_written(
    octopi: Path, tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        convert(octopi, tmp_path / "out", from_format="octopi", options=ConvertOptions(labels=path))
    assert message in str(caught.value)
    assert "bad.csv" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_missing_table_is_refused(octopi: Path, tmp_path: Path) -> None:
    options = ConvertOptions(labels=tmp_path / "none.csv")
    with pytest.raises(UsageError, match=r"none.csv: the table of labels cannot be read"):
        convert(octopi, tmp_path / "out", from_format="octopi", options=options)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_bytes(b"part_id\n\xff\xfe\n")
    with pytest.raises(UsageError, match="not a CSV table in UTF-8"):
        read_labels(path)
