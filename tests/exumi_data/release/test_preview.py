import random
from pathlib import Path
from typing import Any

from exumi_data.manifest import MANIFEST_NAME
from exumi_data.release.preview import PREVIEW_FOLDER, choose_preview
from exumi_data.release.verifying import verify_release
from exumi_validators import validate
from tests.exumi_data.release.making import Release

MB = 1_000_000


def row(number: int, **values: Any) -> dict[str, Any]:
    """A row of a catalog, as far as a preview looks at it."""
    plain = dict.fromkeys(
        ("task", "regime", "object_id", "part_id", "procedure", "pad_type", "success")
    )
    stream = {"name": "tactile", "kind": "tactile", "encoding": "encoded"}
    shown = {"quality": [], "labels": [], "streams": [stream], **plain, **values}
    return {"id": f"{number:04}", **shown}


def test_each_task_object_and_label_is_shown() -> None:
    rows = [
        row(
            number,
            task=f"task {number % 3}",
            object_id=f"object {number % 20}",
            labels=[
                {"property": "hardness", "number": float(number % 10), "text": None},
                {"property": "feel", "number": None, "text": "soft|wet" if number == 7 else "dry"},
            ],
        )
        for number in range(200)
    ]
    sizes = {one["id"]: MB // 10 for one in rows}
    chosen = choose_preview(rows, sizes, 5 * MB)
    shown = [one for one in rows if one["id"] in chosen]
    for column, count in (("task", 3), ("object_id", 20)):
        assert len({one[column] for one in shown}) == count
    assert "0007" in chosen
    assert {min(int(one["labels"][0]["number"] / 1.8), 4) for one in shown} == {0, 1, 2, 3, 4}
    # A tenth of the dataset, and not more than was asked for.
    assert 20 <= len(chosen) <= 22
    # Whatever the order.
    random.Random(3).shuffle(rows)  # noqa: S311  # an order, no secret
    assert choose_preview(rows, sizes, 5 * MB) == chosen


def test_it_fits() -> None:
    rows = [row(number, object_id=str(number)) for number in range(30)]
    sizes = {one["id"]: (number + 1) * MB for number, one in enumerate(rows)}
    chosen = choose_preview(rows, sizes, 10 * MB)
    assert chosen == ["0000", "0001", "0002"]  # 1 + 2 + 3 MB: as many objects as fit
    assert choose_preview(rows, sizes, 0) == []
    assert choose_preview(rows, sizes, MB) == []
    assert choose_preview([], {}, MB) == []


def test_it_is_a_dataset_and_a_release_of_its_own(
    source: Path, tmp_path: Path, release: Release
) -> None:
    built = release(source, tmp_path / "out", preview_bytes=MB)
    folder = tmp_path / "out" / PREVIEW_FOLDER
    assert 0 < built.preview_bytes <= MB
    assert validate(folder).valid
    assert validate(folder).codes().keys() <= validate(source).codes().keys()
    assert verify_release(folder).good
    assert (folder / MANIFEST_NAME).is_file()
    assert (folder / "LICENSE").read_bytes() == (tmp_path / "out" / "LICENSE").read_bytes()


def test_none_is_made_where_nothing_fits(source: Path, tmp_path: Path, release: Release) -> None:
    assert release(source, tmp_path / "out", preview_bytes=1000).preview == ()
    assert not (tmp_path / "out" / PREVIEW_FOLDER).exists()
