"""The calibration file: written whole, read with precise errors, merged."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from exumi_data.errors import (
    DamagedDataError,
    LimitError,
    MetadataError,
    UnsupportedError,
    UsageError,
)
from exumi_data.model import CalibrationItem
from exumi_recorders.calibration import files
from exumi_recorders.calibration.files import (
    Calibration,
    array_path,
    merge,
    read_calibration,
    update,
    write_calibration,
)

IMAGE = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
NAME = "tactile_reference/left"


def item(value: object = 1, *, array: bool = False) -> CalibrationItem:
    return CalibrationItem(
        value=None if array else value, method="m", array=array_path(NAME) if array else None
    )


def with_array() -> Calibration:
    return Calibration({"a": item(), NAME: item(array=True)}, {NAME: IMAGE})


def test_what_was_written_is_read(tmp_path: Path) -> None:
    path = write_calibration(tmp_path / "rig.json", with_array())
    found = read_calibration(path)
    assert found.items == with_array().items
    assert np.array_equal(found.arrays[NAME], IMAGE)
    assert len(list(tmp_path.iterdir())) == 2


def test_an_update_replaces_and_keeps(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    update(path, with_array())
    update(path, Calibration({"a": item(2), "b": item(3)}))
    other = Calibration({NAME: item(array=True)}, {NAME: IMAGE + 1})
    update(path, other)
    found = read_calibration(path)
    assert {n: i.value for n, i in found.items.items()} == {"a": 2, "b": 3, NAME: None}
    assert np.array_equal(found.arrays[NAME], IMAGE + 1)
    # The arrays that are out of date are gone; nothing half-written is left.
    assert len(list(tmp_path.iterdir())) == 2
    update(path, Calibration({NAME: item(4)}))
    assert [p.name for p in tmp_path.iterdir()] == ["rig.json"]


@pytest.mark.parametrize(
    ("document", "error", "said"),
    [
        ("", MetadataError, "not valid JSON"),
        ("[]", MetadataError, "JSON object"),
        ('{"format": "exumi-episode", "version": "1.0"}', MetadataError, "exumi-calibration"),
        ('{"format": "exumi-calibration", "version": "2.0"}', UnsupportedError, "newer"),
        (
            '{"format": "exumi-calibration", "version": "1.0", "items": {"a": {"unit": "m"}}}',
            MetadataError,
            r"\$\.items\.a\.value",
        ),
        (
            '{"format": "exumi-calibration", "version": "1.0", "items": {}, "arrays": '
            '{"file": "../x.npz", "sha256": "' + 64 * "0" + '"}}',
            MetadataError,
            r"\$\.arrays\.file",
        ),
        (
            '{"format": "exumi-calibration", "version": "1.0", "items": {"a": {"value": 1, '
            '"array": "calibration/a"}}}',
            DamagedDataError,
            "do not fit together: a",
        ),
    ],
)
def test_no_calibration(tmp_path: Path, document: str, error: type[Exception], said: str) -> None:
    path = tmp_path / "rig.json"
    path.write_text(document)
    with pytest.raises(error, match=said):
        read_calibration(path)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such calibration file"):
        read_calibration(tmp_path / "rig.json")
    for name in ("rig.txt", ".json", "a b.json"):
        with pytest.raises(UsageError, match="no name for a calibration file"):
            write_calibration(tmp_path / name, Calibration())


def test_arrays_that_are_others(tmp_path: Path) -> None:
    path = write_calibration(tmp_path / "rig.json", with_array())
    arrays = next(tmp_path.glob("*.npz"))
    whole = arrays.read_bytes()
    arrays.write_bytes(whole[:-1])
    with pytest.raises(DamagedDataError, match="not the arrays"):
        read_calibration(path)
    arrays.unlink()
    with pytest.raises(DamagedDataError, match="cannot be read"):
        read_calibration(path)


def stated(path: Path, arrays: bytes) -> None:
    """Put bytes in the place of the arrays, with their digest."""
    import hashlib

    document = json.loads(path.read_text())
    document["arrays"]["sha256"] = hashlib.sha256(arrays).hexdigest()
    path.write_text(json.dumps(document))
    path.with_name(document["arrays"]["file"]).write_bytes(arrays)


def test_arrays_of_a_stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_calibration(tmp_path / "rig.json", with_array())
    stated(path, b"no zip")
    with pytest.raises(DamagedDataError, match="no arrays"):
        read_calibration(path)
    objects = io.BytesIO()
    np.savez(objects, np.array([{}], dtype=object))
    stated(path, objects.getvalue())
    with pytest.raises(DamagedDataError, match="no arrays"):
        read_calibration(path)
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.npy", bytes(1_000_000))
    stated(path, bomb.getvalue())
    monkeypatch.setattr(files, "_MOST_ARRAY_BYTES", 100_000)
    with pytest.raises(LimitError, match="unpacked"):
        read_calibration(path)


def test_a_merge(tmp_path: Path) -> None:
    both = merge({"one": Calibration({"a": item()}), "two": with_array()})
    assert set(both.items) == {"a", NAME}
    assert np.array_equal(both.arrays[NAME], IMAGE)
    with pytest.raises(UsageError, match="two: 'a' is another one in one"):
        merge({"one": Calibration({"a": item(2)}), "two": with_array()})
    other = Calibration({NAME: item(array=True)}, {NAME: IMAGE + 1})
    with pytest.raises(UsageError, match="is another one"):
        merge({"one": with_array(), "two": other})
    assert merge({"one": with_array(), "two": with_array()}).items == with_array().items


def test_names_of_arrays() -> None:
    with pytest.raises(ValueError, match="cannot have an array"):
        array_path("T_Controller")


def test_half_of_a_letter_is_no_calibration(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    head = '{"format": "exumi-calibration", "version": "1.0", "items": {"note": {"value": '
    path.write_text(head + '"\\ud800"}}}')
    with pytest.raises(MetadataError, match="half of a letter"):
        read_calibration(path)
